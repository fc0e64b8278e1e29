"""The one place where JSON from a page is decoded."""

import json
import math
from typing import Any, NoReturn

MAX_DIGITS = 22
"""Of an integer. JavaScript writes larger ones with an exponent; in Python they may not fit into a float."""


def from_page(text: str) -> Any:
    """Return what a page has sent; all numbers in it are finite.

    Raises:
        ValueError: it is not JSON, too deep, or has a number that no page sends.
    """
    try:
        return json.loads(text, parse_int=_integer, parse_float=_finite, parse_constant=_refused)
    except RecursionError as error:
        raise ValueError("too deep") from error


def _integer(text: str) -> int:
    return int(text) if len(text) <= MAX_DIGITS else _refused(text)


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _refused(text)


def _refused(text: str) -> NoReturn:
    raise ValueError(f"no page sends the number {text[:MAX_DIGITS]}")
