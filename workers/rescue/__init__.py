"""Searches for victims, and decides what the rescue robot does next."""
