"""Draw key sweeps into an occupancy grid, and redraw those whose poses have moved."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.occupancy_grid import GridFull, GrowingGrid
from robbie_robots.workers.planar_pose import transform_points, wrap_angle

MOVED_CELLS = 0.5
MOVED_RAD = 0.005
MOVES_SHARE = 0.04  # of an update: each closed loop moves most of a large map a little


class MapRenderer:
    """Keeps an occupancy grid in step with key sweeps.

    Attributes:
        left_out: Number of sweeps not drawn because the grid is at its limit.
        behind: Number of sweeps that the last update left for the next one.
    """

    def __init__(self, keys: KeySweeps, grid: GrowingGrid) -> None:
        self.grid = grid
        self.left_out = 0
        self.behind = 0
        self._keys = keys
        self._drawn = np.full((0, 3), np.nan)  # pose at which each sweep is drawn; NaN: not drawn
        self._on_grid = np.zeros(0, dtype=bool)  # a restored sweep has a pose, but is not on the grid yet
        self._refused = np.zeros(0, dtype=bool)  # the grid was full

    def update(self, most: int | None = None) -> None:
        """Draw the new sweeps, and redraw those that have moved.

        Args:
            most: Maximum number of new sweeps to draw. The maximum number of moved ones is much smaller.
                Those nearest to the newest sweep come first.
        """
        poses = self._keys.poses
        missing = len(poses) - len(self._drawn)
        self._drawn = np.concatenate([self._drawn, np.full((missing, 3), np.nan)])
        self._on_grid = np.concatenate([self._on_grid, np.zeros(missing, dtype=bool)])
        self._refused = np.concatenate([self._refused, np.zeros(missing, dtype=bool)])
        off = np.abs(poses - self._drawn)
        off[:, 2] = wrap_angle(off[:, 2])
        still = (off[:, :2].max(axis=1) < MOVED_CELLS * self.grid.resolution_m) & (
            np.abs(off[:, 2]) < MOVED_RAD
        )
        every = np.flatnonzero(~(still & self._on_grid))
        waiting, changed = every[:0], every
        if most is not None and len(every):
            apart = np.hypot(*(poses[every] - poses[-1])[:, :2].T)
            # Sweeps that the full grid has refused come last, so that they do not keep the others waiting.
            every = every[np.lexsort((apart, self._refused[every]))]
            moved = self._on_grid[every]
            chosen = np.where(
                moved, np.cumsum(moved) <= max(1, round(MOVES_SHARE * most)), np.cumsum(~moved) <= most
            )
            waiting, changed = every[~chosen], np.sort(every[chosen])
        for number in changed[self._on_grid[changed]].tolist():
            self._erase(number)
        for number in changed.tolist():
            if not still[number]:
                self._drawn[number] = poses[number]
            try:
                self.grid.add(*self._sweep(number, self._drawn[number]))
                self._on_grid[number] = True
            except GridFull:
                self._drawn[number] = np.nan
            self._refused[number] = not self._on_grid[number]
        self.behind = int((~self._refused[waiting]).sum())
        self.left_out = int(self._refused.sum())

    def forget(self, numbers: Sequence[int]) -> None:
        """Erase sweeps that are about to be removed from the key sweeps."""
        known = [number for number in numbers if number < len(self._drawn)]
        for number in known:
            if self._on_grid[number]:
                self._erase(number)
        self._drawn = np.delete(self._drawn, known, axis=0)
        self._on_grid = np.delete(self._on_grid, known)
        self._refused = np.delete(self._refused, known)

    def state(self) -> dict[str, Any]:
        """Return which sweeps are drawn and where: enough to draw the same grid again."""
        return {"drawn": self._drawn}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned. The next updates draw the grid."""
        self._drawn = np.array(state["drawn"], float)
        self._on_grid = np.zeros(len(self._drawn), dtype=bool)
        self._refused = np.zeros(len(self._drawn), dtype=bool)

    def _erase(self, number: int) -> None:
        self.grid.remove(*self._sweep(number, self._drawn[number]))
        self._on_grid[number] = False

    def _sweep(
        self, number: int, pose: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return pose[:2], transform_points(pose, self._keys.sweeps[number].hits.points)
