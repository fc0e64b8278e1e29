"""Obstacles that the laser sees now, on the map or not. It forgets those no longer seen.

The obstacle layer of Marder-Eppstein et al., "The office marathon" (ICRA 2010), with the decay of Macenski et
al., "Spatio-temporal voxel layer" (IJARS 2020); kept as a list of cells, so it does not depend on the map.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.planar_pose import relative, transform_points

HERE = np.zeros(3)
MAX_BEHIND_S = 1.0  # an older sweep of another laser does not say any more what can be seen through


class LiveObstacles:
    """Cells that beams hit recently.

    Args:
        resolution_m: Edge of a cell.
        range_m: Farther returns are ignored.
        decay_s: A cell is forgotten this long after its last hit.
        most: Maximum number of cells; beyond it those hit longest ago are dropped.
    """

    def __init__(
        self, resolution_m: float = 0.05, range_m: float = 4.0, decay_s: float = 15.0, most: int = 20_000
    ) -> None:
        self._resolution_m = resolution_m
        self._range_m = range_m
        self._decay_s = decay_s
        self._most = most
        self.forget()

    def __len__(self) -> int:
        return len(self._cells)

    def forget(self) -> None:
        """Forget all obstacles."""
        self._cells = np.empty((0, 2), dtype=np.int64)
        self._hit_s = np.empty(0)
        self._newest: dict[str, tuple[NDArray[np.float64], LaserSweep, float]] = {}

    def see(self, laser: ArrayLike, sweep: LaserSweep, now_s: float, name: str = "") -> None:
        """Add a sweep: cells that it hit are obstacles, cells that it saw as free are not.

        Args:
            laser: Pose of the laser (x m, y m, heading rad), map frame.
            sweep: The sweep.
            now_s: The time.
            name: Name of the laser, if there are several.
        """
        kept_s = now_s - MAX_BEHIND_S
        self._newest = {other: seen for other, seen in self._newest.items() if seen[2] >= kept_s}
        self._newest[name] = np.asarray(laser, float), sweep, now_s
        kept = now_s - self._hit_s < self._decay_s
        kept &= ~sweep.looked_through(transform_points(relative(laser, HERE), self._middles(self._cells)))
        hit = np.floor(transform_points(laser, sweep.points(self._range_m)) / self._resolution_m).astype(
            np.int64
        )
        cells = np.concatenate([hit, self._cells[kept]])
        hit_s = np.concatenate([np.full(len(hit), now_s), self._hit_s[kept]])
        # Of equal cells, keep the first one: the newest.
        _, first = np.unique(cells, axis=0, return_index=True)
        first = np.sort(first)[: self._most]
        self._cells, self._hit_s = cells[first], hit_s[first]

    def sees_through(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return through which places `(M, 2)`, m, map frame, within `range_m` the newest sweeps saw."""
        through = np.zeros(len(places), np.bool_)
        for laser, sweep, _ in self._newest.values():
            seen = sweep.looked_through(transform_points(relative(laser, HERE), places))
            through |= seen & (np.hypot(*(places - laser[:2]).T) <= self._range_m)
        return through

    def points(self, now_s: float) -> NDArray[np.float64]:
        """Return the middles of the current obstacle cells: `(N, 2)`, m, map frame."""
        return self._middles(self._cells[now_s - self._hit_s < self._decay_s])

    def _middles(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        middles: NDArray[np.float64] = (cells + np.float64(0.5)) * self._resolution_m
        return middles
