"""Suggestions for mistyped names."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the known names nearest to `name`, or "" if none is near."""
    near = get_close_matches(name, list(known), n=3)
    return f"; did you mean {' or '.join(repr(match) for match in near)}?" if near else ""
