"""ROS 1: its message definitions and its serialisation, and the node that speaks to it."""
