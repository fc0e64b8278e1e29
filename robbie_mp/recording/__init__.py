"""Logs: files that keep what passed on a robot's bus, in the format MCAP; written, read, repaired, compared.

No processes, no modules: see `robbie_mp/services/` for those that record and play.
"""
