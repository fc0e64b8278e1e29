"""Numbered signs: read in camera images, placed on the map, visited in order."""
