"""What Linux offers and Python does not: process information, scheduling, private files, forks."""
