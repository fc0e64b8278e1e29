"""Manual driving: from the pad, keys or gamepad of one page to the base, and what the robot makes of it."""
