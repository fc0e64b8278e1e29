"""Dynamixel servos of Robotis."""
