"""Robbie-MP: a robot framework for robots that must keep going."""
