"""Modules of the rescue robot."""
