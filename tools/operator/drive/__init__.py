"""An operator in a browser drives the robot by keys, with what the layout Drive shows; see `__main__`."""
