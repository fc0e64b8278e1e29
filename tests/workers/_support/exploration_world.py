"""A world for the exploration's tests: rooms drawn with characters, and a map that knows the true poses."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.maps.navigation_grid import NavigationGrid

RESOLUTION_M = 0.05
CLEARANCE_M = 0.27
PERCENT = {"#": 100, ".": 0, " ": -1}


def drawn_cells(drawing: str, cells_per_character: int = 5) -> np.ndarray:
    """Occupancy of a drawing: `#` occupied, `.` free, space unknown; its last line is at y = 0."""
    rows = [[PERCENT[character] for character in line] for line in drawing.strip("\n").splitlines()]
    small = np.array(rows, dtype=np.int8)[::-1]
    return np.kron(small, np.ones((cells_per_character,) * 2, dtype=np.int8))


def drawn_grid(drawing: str, corner_xy_m: ArrayLike = (0.0, 0.0)) -> NavigationGrid:
    return NavigationGrid(drawn_cells(drawing), RESOLUTION_M, corner_xy_m, CLEARANCE_M)


class TruePoseMap:
    """A map from sweeps at true poses: what beams pass is free, what they hit stays a wall."""

    def __init__(self, width_m: float, height_m: float, margin_m: float = 0.5) -> None:
        shape = np.round((np.array([height_m, width_m]) + 2 * margin_m) / RESOLUTION_M).astype(int)
        self.cells = np.full(shape, -1, dtype=np.int8)
        self.corner_xy_m = np.full(2, -margin_m)

    def add(
        self, pose: Sequence[float], ranges_m: NDArray[np.floating[Any]], angles_rad: NDArray[np.float64]
    ) -> None:
        returned = np.isfinite(ranges_m)
        ranges, angles = ranges_m[returned], angles_rad[returned] + pose[2]
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        along = np.arange(0.0, 8.0, RESOLUTION_M)
        beam, step = np.nonzero(along < ranges[:, None] - RESOLUTION_M)
        passed = self._index(np.array(pose[:2]) + along[step, None] * directions[beam])
        hit = self._index(np.array(pose[:2]) + ranges[:, None] * directions)
        walls = self.cells == 100
        self.cells[passed] = 0
        self.cells[walls] = 100
        self.cells[hit] = 100

    def _index(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        columns, rows = np.floor((points - self.corner_xy_m) / RESOLUTION_M).astype(int).T
        inside = (rows >= 0) & (columns >= 0) & (rows < self.cells.shape[0]) & (columns < self.cells.shape[1])
        return rows[inside], columns[inside]
