"""Cameras on V4L2, on the network, or in files."""
