"""Flat pictures that hang on walls."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Texture:
    """A picture, transparent in places.

    Attributes:
        values: (rows, columns) or (rows, columns, 3), what it shows; of an even number of rows and columns.
        opaque: (rows, columns), where it shows anything.
        texel_m: edge of an element.
        anchor_row: the row whose middle column hangs at the picture's spot; the upper edge is 0.
    """

    values: NDArray[Any]
    opaque: NDArray[np.bool_]
    texel_m: float
    anchor_row: float

    def halved(self) -> "Texture":
        """Return the picture with half as many rows and columns, for cameras that are far away."""
        weight = _of_four(self.opaque.astype(np.float32)).sum(axis=0)
        shape = self.opaque.shape + (1,) * (self.values.ndim - 2)
        summed = _of_four(self.values * self.opaque.reshape(shape)).sum(axis=0)
        values = summed / np.maximum(weight, 1).reshape(weight.shape + (1,) * (summed.ndim - 2))
        return Texture(values.astype(self.values.dtype), weight >= 2, self.texel_m * 2, self.anchor_row / 2)


def halvings(texture: Texture, count: int = 4) -> tuple[Texture, ...]:
    """Return a picture, its half, the half of that, …: so many of them."""
    levels = [texture]
    for _ in range(count - 1):
        levels.append(levels[-1].halved())
    return tuple(levels)


def _of_four(values: NDArray[Any]) -> NDArray[np.float32]:
    """Return the four elements of each square of two by two: (4, rows / 2, columns / 2, …)."""
    parts = [values[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    return np.stack(parts).astype(np.float32)
