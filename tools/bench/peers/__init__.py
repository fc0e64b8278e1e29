"""What Robbie is measured beside: other transports, and two floors; one small file each."""
