"""Modules that drive to goals and explore."""
