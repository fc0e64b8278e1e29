"""Modules that make maps and find the robot on them."""
