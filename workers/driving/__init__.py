"""Driving: who controls the robot, whatever it drives for."""
