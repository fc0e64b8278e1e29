"""USB relay boards of LC Technology."""
