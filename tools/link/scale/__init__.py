"""Measures how links scale with the number of robots at one router of Zenoh."""
