"""Modules of the robot that grasps, carries and puts down objects."""
