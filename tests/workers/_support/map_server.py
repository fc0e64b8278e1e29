"""What a map_server makes of a map, pixel by pixel, by Nav2's published rules; knows nothing of our reader.

The rules are those of map_mode.hpp and map_io.cpp, with the average of the channels as ROS's wiki has it.
"""

import math
from fractions import Fraction
from typing import NamedTuple

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
TIE = Fraction(1, 10**6)


class Pixel(NamedTuple):
    """Brightness from 0 (black) to 1 (white), and whether nothing shines through."""

    shade: Fraction
    is_opaque: bool = True


class Rules(NamedTuple):
    """What the YAML file of a map says."""

    mode: str
    negate: bool
    occupied_thresh: str
    free_thresh: str


def allowed_values(rules: Rules, pixel: Pixel) -> set[int]:
    """Return what a cell may be: one value, or two if the exact one lies half-way between them."""
    if rules.mode == "raw":
        return {one if 0 <= one <= 100 else UNKNOWN for one in _rounded(pixel.shade * 255)}
    if not pixel.is_opaque:
        return {UNKNOWN}
    occ = pixel.shade if rules.negate else 1 - pixel.shade
    least, most = Fraction(rules.occupied_thresh), Fraction(rules.free_thresh)
    if occ >= least:
        return {OCCUPIED}
    if occ <= most:
        return {FREE}
    return _rounded((occ - most) / (least - most) * 100) if rules.mode == "scale" else {UNKNOWN}


def _rounded(value: Fraction) -> set[int]:
    return {math.floor(value + Fraction(1, 2) + tie) for tie in (-TIE, TIE)}
