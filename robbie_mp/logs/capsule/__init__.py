"""Capsules: one file for each crash of a module, with all that is needed to run it again."""
