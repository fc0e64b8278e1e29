"""The emergency stop: its button, its own connection, and the presses that the base has not confirmed."""
