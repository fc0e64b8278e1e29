"""Modules of the robot that drives to numbered signs in order."""
