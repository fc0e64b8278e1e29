"""Occupancy grid: how likely it is that each cell of the plane holds an obstacle.

After Elfes, "Using occupancy grids for mobile robot perception and navigation" (IEEE Computer, 1989), and
Moravec and Elfes (ICRA 1985): the evidence of each sweep adds to the log-odds of a cell. The grid stores two
counts (beams that ended in a cell, sweeps that looked through it) and computes the log-odds from them. So it
can remove a sweep exactly when its pose is corrected.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LOG_ODDS_HIT = 0.85  # a beam ended here: occupied with p = 0.70
LOG_ODDS_PASS = -0.4  # a sweep looked through: occupied with p = 0.40
GROWTH_M = 5.0


class GridFull(MemoryError):
    """The explored area exceeds the grid's limit."""


class OccupancyGrid:
    """A grid that grows with the explored area, up to a limit.

    Args:
        resolution_m: Edge of a cell.
        max_cells: Maximum number of cells (8 bytes each).
    """

    def __init__(self, resolution_m: float = 0.05, max_cells: int = 16_000_000) -> None:
        self.resolution_m = resolution_m
        self.max_cells = max_cells
        self._corner = np.zeros(2, dtype=np.int64)  # cell coordinates of the array's first cell
        self._hits = np.zeros((0, 0), dtype=np.int32)
        self._passes = np.zeros((0, 0), dtype=np.int32)

    def add(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Add a sweep: `points` `(N, 2)`, m, map frame, were hit by beams from `origin_xy_m`.

        Raises:
            GridFull: The sweep would make the grid exceed its limit of cells. The grid does not change.
        """
        sweep = self._drawn(origin_xy_m, points)
        self._cover(sweep.corner, sweep.corner + sweep.hits.shape[::-1])
        self._count(sweep, 1)

    def remove(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Remove a sweep that was added with exactly these values."""
        self._count(self._drawn(origin_xy_m, points), -1)

    def cells(self) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return the map in ROS's form, and its position.

        Returns:
            Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 where nothing was seen; and the
            position (x, y) of the outer corner of cell (0, 0), m, map frame.
        """
        percent: NDArray[np.int8] = np.full(self._hits.shape, -1, dtype=np.int8)
        seen = (self._hits > 0) | (self._passes > 0)
        log_odds = LOG_ODDS_HIT * self._hits[seen] + LOG_ODDS_PASS * self._passes[seen]
        percent[seen] = np.round(100 / (1 + np.exp(-log_odds)))
        corner_m: NDArray[np.float64] = self._corner * np.float64(self.resolution_m)
        return percent, corner_m

    def state(self) -> dict[str, Any]:
        """Return the counts of all cells and their position. The next `add` may change the arrays."""
        return {"corner": self._corner, "hits": self._hits, "passes": self._passes}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._corner = np.array(state["corner"], dtype=np.int64)
        self._hits = np.array(state["hits"], dtype=np.int32)
        self._passes = np.array(state["passes"], dtype=np.int32)

    def _drawn(self, origin_xy_m: ArrayLike, points: ArrayLike) -> "_Sweep":
        """Draw one sweep. A cell that it hit does not count as looked through."""
        origin, ends = np.asarray(origin_xy_m, float), np.asarray(points, float).reshape(-1, 2)
        beams = ends - origin
        length = np.hypot(beams[:, 0], beams[:, 1])
        steps = np.floor(length / self.resolution_m).astype(np.int64)
        beam = np.repeat(np.arange(len(ends)), steps)
        step = np.arange(len(beam)) - np.repeat(np.cumsum(steps) - steps, steps)
        along = origin + beams[beam] * (step * self.resolution_m / length[beam])[:, None]
        hit, passed = (np.floor(places / self.resolution_m).astype(np.int64) for places in (ends, along))
        every = np.concatenate([hit, passed, np.floor(origin / self.resolution_m).astype(np.int64)[None]])
        corner = every.min(axis=0)
        shape = tuple((every.max(axis=0) - corner + 1)[::-1])
        hits, passes = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=bool)
        passes[passed[:, 1] - corner[1], passed[:, 0] - corner[0]] = True
        np.add.at(hits, (hit[:, 1] - corner[1], hit[:, 0] - corner[0]), 1)
        return _Sweep(corner, hits, passes & (hits == 0))

    def _cover(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Grow the arrays to hold the cells from `low` up to, but not including, `high`."""
        shape = np.array(self._hits.shape[::-1])
        if (low >= self._corner).all() and (high <= self._corner + shape).all():
            return
        if shape.any():
            margin = int(GROWTH_M / self.resolution_m)
            low = np.where(low < self._corner, low - margin, self._corner)
            high = np.where(high > self._corner + shape, high + margin, self._corner + shape)
        if int(np.prod(high - low)) > self.max_cells:
            width, height = (high - low) * self.resolution_m
            raise GridFull(
                f"a map of {width:.0f} m x {height:.0f} m at {self.resolution_m} m is more than "
                f"{self.max_cells} cells; choose a coarser resolution or allow more cells"
            )
        column, row = self._corner - low
        grown = [np.zeros((high - low)[::-1], dtype=np.int32) for _ in range(2)]
        for larger, counts in zip(grown, (self._hits, self._passes), strict=True):
            larger[row : row + shape[1], column : column + shape[0]] = counts
        self._hits, self._passes = grown
        self._corner = low

    def _count(self, sweep: "_Sweep", by: int) -> None:
        column, row = sweep.corner - self._corner
        box = np.s_[row : row + sweep.hits.shape[0], column : column + sweep.hits.shape[1]]
        self._hits[box] += by * sweep.hits
        self._passes[box] += by * sweep.passes


@dataclass(frozen=True)
class _Sweep:
    """One sweep as a grid: the number of beams that ended in each cell, and the cells looked through."""

    corner: NDArray[np.int64]
    hits: NDArray[np.int32]
    passes: NDArray[np.bool_]
