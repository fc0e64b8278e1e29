"""Arguments that are times or sizes, for argparse: each is written as people do, and has limits."""

import argparse
import re
from collections.abc import Callable

from robbie_mp.base.amount import BadAmount, bytes_of, seconds_of

LONGEST_S = 1e9


def time_between(least_s: float, most_s: float = LONGEST_S) -> Callable[[str], float]:
    """Return the parser of a time, in s, with these limits."""

    def parse(text: str) -> float:
        try:
            seconds = seconds_of(text)
        except BadAmount as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        if not least_s <= seconds <= most_s:
            raise argparse.ArgumentTypeError(f"expected {least_s:g} s to {most_s:g} s; got {text}")
        return seconds

    return parse


def size_between(least: int, most: int) -> Callable[[str], int]:
    """Return the parser of a size, in bytes, with these limits."""

    def parse(text: str) -> int:
        try:
            size = bytes_of(text)
        except BadAmount as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        if not least <= size <= most:
            raise argparse.ArgumentTypeError(f"expected {least} to {most} bytes; got {text}")
        return size

    return parse


def whole_between(least: int, most: int = 2**63 - 1) -> Callable[[str], int]:
    """Return the parser of a whole number with these limits."""

    def parse(text: str) -> int:
        if not re.fullmatch("[+-]?[0-9]{1,19}", text) or not least <= int(text) <= most:
            expected = f"a whole number from {least}" + (f" to {most}" if most < 2**63 - 1 else "")
            raise argparse.ArgumentTypeError(f"expected {expected}; got {text!r:.40}")
        return int(text)

    return parse
