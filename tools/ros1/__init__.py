"""A robot beside a real ROS 1: its bridge, the ROS master and the ROS node are killed at random."""
