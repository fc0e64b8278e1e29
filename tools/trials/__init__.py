"""Trials: what a robot or a part of it does over many seeds, judged by the truth.

`python -m tools.trials` lists the subjects. Each is a module of a room of this package, which contains only
what is particular to it: a `SUBJECT` for the harness says what a seed makes, how it is played and judged.
"""
