"""The module that finds people."""
