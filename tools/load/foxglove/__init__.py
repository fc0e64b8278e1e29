"""Measures what clients of Foxglove cost the modules of a robot: `python -m tools.load.foxglove`."""
