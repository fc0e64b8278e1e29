"""Everything to write a module with, and the runner of modules."""
