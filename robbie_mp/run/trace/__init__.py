"""The trace: entries of what processes log and print and of their ends, their transport, and readers."""
