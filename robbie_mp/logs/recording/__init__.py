"""Logs: MCAP files that keep the messages of a robot's bus; written, read, repaired and compared here.

This package starts no processes and has no modules; `robbie_mp/logs/` has those that record and play.
"""
