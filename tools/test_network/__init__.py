"""Hosts on this machine with a bad network between them, to test what a radio link does to robots."""
