"""The transports that Robbie is compared with, and the floors; one small file each."""
