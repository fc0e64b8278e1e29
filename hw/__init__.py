"""Devices: each talks to one piece of hardware, real or simulated; none knows of messages or modules."""
