"""Devices: each talks to one piece of hardware, real or simulated, and knows nothing of messages or modules."""
