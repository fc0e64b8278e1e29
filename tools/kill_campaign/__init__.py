"""Kills processes of a live robot at random moments and checks afterwards that nothing went uncounted."""
