"""What recording everything costs a robot: its log, its logger, and the latency of its other modules."""
