"""The operator's page in a real browser: how soon the robot stops, and whether one can drive by it."""
