"""Measures what it costs a robot to record everything: processor time, disk, and latency of other modules."""
