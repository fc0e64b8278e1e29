"""SICK laser range finders."""
