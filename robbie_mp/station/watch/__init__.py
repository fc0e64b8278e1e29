"""What the station knows of the robot now: newest messages, figures, settings, images, lights."""
