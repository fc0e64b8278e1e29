"""Modules that serve the system as a whole."""
