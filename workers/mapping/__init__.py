"""Builds a grid map from laser sweeps and odometry, and closes loops."""
