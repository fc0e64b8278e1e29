"""Measures how soon a robot stands after a single failure, for every way to drive it; see `__main__`."""
