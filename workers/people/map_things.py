"""What the map shows: a thing there is no person, unless it moves."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

OCCUPIED = 65
NEAR_CELLS = 2


class MapThings:
    """Says which places are on, or right beside, what a map shows.

    Args:
        cells: (H, W) int8, 0 free to 100 occupied, -1 unknown.
        resolution_m: edge of a cell.
        corner_xy_m: outer corner of cell (0, 0), m, map frame.
    """

    def __init__(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: Sequence[float]) -> None:
        self._things = ndimage.binary_dilation(cells >= OCCUPIED, iterations=NEAR_CELLS)
        self._resolution_m = resolution_m
        self._corner = np.asarray(corner_xy_m, np.float64)

    def at(self, points_m: ArrayLike) -> NDArray[np.bool_]:
        """Return which points (N, 2), m, map frame, are there: (N,)."""
        points = np.asarray(points_m, np.float64).reshape(-1, 2)
        column, row = np.floor((points - self._corner) / self._resolution_m).astype(np.intp).T
        height, width = self._things.shape
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        found = np.zeros(len(points), np.bool_)
        found[inside] = self._things[row[inside], column[inside]]
        return found
