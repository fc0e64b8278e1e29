"""Recordings: write, read, capture and play them."""
