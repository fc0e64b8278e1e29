"""Recordings: what modules make of them, and how fast one can move in them."""
