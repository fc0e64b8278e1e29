"""Reads damaged files and messages with every reader: see `__main__.py`."""
