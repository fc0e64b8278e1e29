"""Connects a run to others: robots, ROS 1, ROS 2, Foxglove."""
