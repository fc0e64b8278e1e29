"""Measures what a link between two robots keeps of its promises over a bad network."""
