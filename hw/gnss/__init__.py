"""Receivers of satellite navigation systems."""
