"""Simulated devices, and the arenas that they are in."""
