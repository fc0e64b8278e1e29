"""The stock messages: one file for each ROS package, names and field order exactly as ROS 2 (Jazzy) has them.

Source of each: https://github.com/ros2/common_interfaces and https://github.com/ros2/rcl_interfaces.
"""
