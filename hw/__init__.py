"""Devices: each controls one piece of hardware, real or simulated. They know neither messages nor modules."""
