"""Laser sweeps as points."""
