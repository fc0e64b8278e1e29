"""What ROS 2 expects on the network: names, type hashes, qualities of service, and its two middlewares."""
