"""Modules of the household robot."""
