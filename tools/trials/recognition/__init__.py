"""Trials of what workers recognize, with data of their own."""
