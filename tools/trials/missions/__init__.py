"""Whole missions of the stock robots in simulation, judged by the ground truth."""
