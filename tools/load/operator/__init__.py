"""Measures what the operator's page costs a robot with large maps, cameras and point clouds."""

ROLES = ("operator", "observer")
TILES, LIVE = "tiles", "Live"
"""A page with a layout instead of a tab, and the name of that layout."""
HIDDEN = "hidden"
"""The same page, which then shows another panel instead."""
NICE = 19
"""Of pages that take only the processor time that the robot leaves."""


def token_of(role: str) -> str:
    """Return the token with which an operator or observer logs in."""
    return f"{role}-of-the-loaded-robot"
