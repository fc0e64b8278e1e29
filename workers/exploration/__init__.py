"""Drives the robot to what its map does not show yet."""
