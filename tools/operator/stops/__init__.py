"""Measures how soon the robot stops when the page, its server or the link to it fails; see `__main__`."""
