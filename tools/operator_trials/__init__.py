"""Measures how soon the robot stops when page, server or link fails; see `__main__`."""
