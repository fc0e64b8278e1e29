"""The floor in the pictures of cameras: which place is where, and where the robot will be."""
