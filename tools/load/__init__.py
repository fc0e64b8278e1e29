"""What recording everything costs the other modules."""
