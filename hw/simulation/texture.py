"""Flat pictures that hang on walls."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Texture:
    """A picture, transparent in places.

    Attributes:
        values: (rows, columns) or (rows, columns, 3), the picture's values.
        opaque: (rows, columns), False where the picture is transparent.
        texel_m: edge of an element.
        anchor_row: row whose middle is at the picture's spot, counted from 0 at the upper edge.
    """

    values: NDArray[Any]
    opaque: NDArray[np.bool_]
    texel_m: float
    anchor_row: float
