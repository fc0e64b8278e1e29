"""Benchmarks that compare Robbie with other transports and with two lower bounds ("floors")."""
