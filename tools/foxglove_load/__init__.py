"""Measures what clients of Foxglove cost the modules of a robot: `python -m tools.foxglove_load`."""
