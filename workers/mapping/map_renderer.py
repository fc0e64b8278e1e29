"""Draw key sweeps into an occupancy grid, and redraw those whose poses have moved."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.mapping.key_sweeps import KeySweeps
from workers.mapping.occupancy_grid import GridFull, OccupancyGrid
from workers.planar_pose import transform_points, wrap_angle

MOVED_CELLS = 0.5
MOVED_RAD = 0.005


class MapRenderer:
    """Keeps an occupancy grid in step with key sweeps.

    Attributes:
        left_out: Number of sweeps not drawn because the grid is at its limit.
    """

    def __init__(self, keys: KeySweeps, grid: OccupancyGrid) -> None:
        self.grid = grid
        self.left_out = 0
        self._keys = keys
        self._drawn = np.full((0, 3), np.nan)  # pose at which each sweep is drawn; NaN: not drawn

    def update(self) -> None:
        """Draw the new sweeps, and redraw those that have moved."""
        poses = self._keys.poses
        missing = np.full((len(poses) - len(self._drawn), 3), np.nan)
        self._drawn = np.concatenate([self._drawn, missing])
        off = np.abs(poses - self._drawn)
        off[:, 2] = wrap_angle(off[:, 2])
        still = (off[:, :2].max(axis=1) < MOVED_CELLS * self.grid.resolution_m) & (
            np.abs(off[:, 2]) < MOVED_RAD
        )
        changed = np.flatnonzero(~still).tolist()
        for number in changed:
            if np.isfinite(self._drawn[number, 0]):
                self.grid.remove(*self._sweep(number, self._drawn[number]))
                self._drawn[number] = np.nan
        for number in changed:
            try:
                self.grid.add(*self._sweep(number, poses[number]))
                self._drawn[number] = poses[number]
            except GridFull:
                continue
        self.left_out = int(np.isnan(self._drawn[:, 0]).sum())

    def forget(self, numbers: Sequence[int]) -> None:
        """Erase sweeps that are about to be removed from the key sweeps."""
        for number in numbers:
            if number < len(self._drawn) and np.isfinite(self._drawn[number, 0]):
                self.grid.remove(*self._sweep(number, self._drawn[number]))
        self._drawn = np.delete(
            self._drawn, [number for number in numbers if number < len(self._drawn)], axis=0
        )

    def state(self) -> dict[str, Any]:
        """Return which sweeps are drawn and where. The next `update` may change the arrays."""
        return {"drawn": self._drawn, "grid": self.grid.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._drawn = np.array(state["drawn"], float)
        self.grid.restore(state["grid"])

    def _sweep(
        self, number: int, pose: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return pose[:2], transform_points(pose, self._keys.sweeps[number].hits.points)
