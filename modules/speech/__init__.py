"""Modules that hear and speak."""
