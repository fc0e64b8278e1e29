"""The image of a map as bands of brightness, so that a large image is never in memory as a whole."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_EDGE, MAX_CELLS = 100_000, 1_000_000_000
"""The largest map: its edge, and its area, in cells. A cell takes a byte."""
BAND_BYTES = 1 << 20


class MapImageError(ValueError):
    """An image that cannot be read; the message says why."""


class Band(NamedTuple):
    """Some pixels of an image.

    Attributes:
        rows: Which rows of the image they are, row 0 uppermost.
        columns: Which columns.
        levels: Brightness `(h, w)`, an integer from 0 (black) to the image's `white`.
        opaque: `(h, w)`; None if all are.
    """

    rows: slice
    columns: slice
    levels: NDArray[np.unsignedinteger]
    opaque: NDArray[np.bool_] | None = None


class MapImage(NamedTuple):
    """An image that is being read.

    Attributes:
        kind: File format and type of the pixels, in words.
        white: Level of a white pixel, at least 1.
        bands: All its pixels; you can go through them once.
    """

    kind: str
    width: int
    height: int
    white: int
    bands: Iterator[Band]


def check_size(width: int, height: int) -> None:
    """Refuse an image that is too large.

    Raises:
        MapImageError: It is, or it has no pixels.
    """
    if width < 1 or height < 1:
        raise MapImageError(f"{width} x {height} pixels are no image")
    if max(width, height) > MAX_EDGE or width * height > MAX_CELLS:
        limits = f"{MAX_CELLS:,} pixels and {MAX_EDGE:,} along an edge"
        raise MapImageError(f"{width} x {height} pixels are more than the {limits} that a map may have")


def sum_of(colours: NDArray[np.unsignedinteger]) -> NDArray[np.uint32]:
    """Return the sum of red, green and blue `(h, w)` of pixels `(h, w, 3)`."""
    total = colours[..., 0].astype(np.uint32)  # NumPy's sum over an axis of 3 is several times as slow
    total += colours[..., 1]
    total += colours[..., 2]
    return total
