"""Exploration: drives the robot to the unknown parts of its map."""
