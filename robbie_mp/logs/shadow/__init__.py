"""Runs a variant of a module beside it, with the same messages, and compares what both publish."""
