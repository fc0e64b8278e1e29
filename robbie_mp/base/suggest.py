"""Suggestions for mistyped names."""

import re
from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the known names nearest to `name`, or "" if none is near."""
    near = get_close_matches(name, list(known), n=3)
    return f"; did you mean {' or '.join(repr(match) for match in near)}?" if near else ""


def space_missing(key: str) -> str:
    """Return "; write …" for a key with its value inside it, as YAML reads `{rate:5}`; "" for other keys."""
    match = re.fullmatch(r"(\w+)\s*([:=])\s*(.+)", key)
    if match is None:
        return ""
    name, sign, value = match.groups()
    text = "a space after the colon" if sign == ":" else "a colon and a space"
    return f"; write {text}: `{name}: {value}`"
