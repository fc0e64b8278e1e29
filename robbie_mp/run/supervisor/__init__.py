"""The parent of all processes: starts, watches, restarts and stops them."""
