"""Pan-tilt units of FLIR, formerly Directed Perception."""
