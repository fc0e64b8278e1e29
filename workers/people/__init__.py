"""People around the robot: legs in laser scans, tracks of persons, and how persons are dressed."""
