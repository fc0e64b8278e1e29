"""Driving, mapping and localization alone, in simulated time, judged by the truth."""
