"""Serves a run to Foxglove, live: the door that checks tokens, the server behind it, and a layout."""
