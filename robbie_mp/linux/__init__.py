"""What Linux offers and Python does not: processes, scheduling, ownership of files."""
