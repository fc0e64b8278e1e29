"""What bridges to other systems share: which messages cross, under which names, and what drives the robot."""
