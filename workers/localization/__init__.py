"""Finds the robot's pose on a known map."""
