"""How soon the robot stands whatever becomes of page, server or link; see `__main__`."""
