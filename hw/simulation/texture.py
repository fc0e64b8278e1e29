"""Flat pictures that hang on walls."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Texture:
    """A picture, transparent in places.

    Attributes:
        values: (rows, columns) or (rows, columns, 3), what it shows.
        opaque: (rows, columns), where it shows anything.
        texel_m: edge of an element.
        anchor_row: the row whose middle column hangs at the picture's spot; the upper edge is 0.
    """

    values: NDArray[Any]
    opaque: NDArray[np.bool_]
    texel_m: float
    anchor_row: float
