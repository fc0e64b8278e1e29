"""The sweeps that make up a map, each with its pose in a pose graph."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.laser.surface_points import SurfacePoints
from robbie_robots.workers.mapping.graph_thinning import without
from robbie_robots.workers.mapping.pose_graph import PoseGraph
from robbie_robots.workers.planar_pose import wrap_angle
from robbie_robots.workers.row_log import RowLog

SPACING_M = 0.4  # sweeps nearer to each other show the same surfaces
SPACING_RAD = 0.3
SAME_THING_M = 0.1  # returns nearer to each other than one to two of these show the same thing


class KeySweeps:
    """Sweeps in the order they were taken, their poses (map frame), and the distance travelled at each."""

    def __init__(self) -> None:
        self.sweeps: list[LaserSweep] = []
        self.graph = PoseGraph()
        self._travelled = RowLog(1, sys.maxsize)

    def __len__(self) -> int:
        return len(self.sweeps)

    @property
    def poses(self) -> NDArray[np.float64]:
        """Poses of all sweeps, `(N, 3)`, map frame."""
        return self.graph.poses

    @property
    def travelled_m(self) -> NDArray[np.float64]:
        """Distance travelled at each sweep, `(N,)`, m."""
        return self._travelled.rows[:, 0]

    def add(self, sweep: LaserSweep, pose: ArrayLike) -> int:
        """Append a sweep and return its number."""
        pose = np.asarray(pose, float)
        so_far = self.travelled_m[-1] + np.hypot(*(pose - self.poses[-1])[:2]) if self.sweeps else 0.0
        self._travelled.add([so_far])
        self.sweeps.append(sweep)
        return self.graph.add_pose(pose)

    def remove(self, numbers: Sequence[int]) -> NDArray[np.int64]:
        """Remove sweeps from the map, whose graph must be settled. The others get new numbers.

        Returns:
            For each old sweep `(N,)` the old number of the one that now represents it: itself or its heir.
        """
        self.graph, heirs = without(self.graph, numbers)
        gone = set(numbers)
        self.sweeps = [sweep for number, sweep in enumerate(self.sweeps) if number not in gone]
        self._travelled.restore({"rows": np.delete(self.travelled_m, numbers), "forgotten": 0})
        return heirs

    def state(self) -> dict[str, Any]:
        """Return the whole state, as arrays and a dict of arrays."""
        bearings = [(sweep.angle_min_rad, sweep.angle_increment_rad) for sweep in self.sweeps]
        return {
            "ranges_m": np.concatenate([np.zeros(0), *(sweep.ranges_m for sweep in self.sweeps)]).astype(
                np.float32
            ),
            "beams": np.array([len(sweep.ranges_m) for sweep in self.sweeps], dtype=np.int64),
            "bearings_rad": np.array(bearings, dtype=float).reshape(-1, 2),
            "travelled_m": self.travelled_m,
            "graph": self.graph.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        each = np.split(state["ranges_m"], np.cumsum(state["beams"])[:-1]) if len(state["beams"]) else []
        self.sweeps = [
            LaserSweep.from_ranges(ranges, float(first), float(increment), 0.0, np.inf)
            for ranges, (first, increment) in zip(each, state["bearings_rad"], strict=True)
        ]
        self._travelled.restore({"rows": state["travelled_m"], "forgotten": 0})
        self.graph = PoseGraph.from_state(state["graph"])

    def spaced(self, numbers: Iterable[int], most: int) -> list[int]:
        """Choose up to `most` sweeps that show different surfaces, beginning with the first."""
        chosen: list[int] = []
        for number in numbers:
            if len(chosen) == most:
                break
            if chosen:
                step = self.poses[number] - self.poses[chosen[-1]]
                if np.hypot(step[0], step[1]) < SPACING_M and abs(wrap_angle(step[2])) < SPACING_RAD:
                    continue
            chosen.append(int(number))
        return chosen

    def lasting_surfaces(self, numbers: Sequence[int], *, but_all_if_few: bool = True) -> SurfacePoints:
        """Join the surface points of some sweeps, without narrow things that only one of them saw.

        Those may be people, or other things that move.

        Args:
            numbers: The sweeps.
            but_all_if_few: Whether the narrow things of a sweep that shows hardly anything else stay: it may
                show trunks or pillars.
        """
        each = [self.sweeps[number].walls.moved(self.poses[number]) for number in numbers]
        joined = SurfacePoints.joined(each)
        owner = np.repeat(np.arange(len(each)), [len(one) for one in each])
        is_narrow = np.zeros(len(joined), np.bool_)
        first = np.cumsum([0, *(len(one) for one in each)])
        for begin, number in zip(first[:-1], numbers, strict=True):  # a sweep's hits, then what lies between
            sweep = self.sweeps[number]
            narrow = ~sweep.is_wide if but_all_if_few else sweep.hits.narrow()
            is_narrow[begin : begin + len(narrow)] = narrow
        stays = ~is_narrow
        stays[is_narrow] = _seen_by_others(joined.points, owner, np.flatnonzero(is_narrow))
        return joined.chosen(stays)

    def surfaces(self, numbers: Iterable[int]) -> SurfacePoints:
        """Join the surface points of some sweeps, map frame."""
        return SurfacePoints.joined(
            [self.sweeps[number].walls.moved(self.poses[number]) for number in numbers]
        )


def _seen_by_others(
    points: NDArray[np.float64], owner: NDArray[np.int64], which: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which of some points lie near a point of another owner."""
    cells = np.floor(points / SAME_THING_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    width = int(cells[:, 0].max()) + 2
    place = cells[:, 1] * width + cells[:, 0]
    sweeps = int(owner.max()) + 1
    pairs = np.unique(place * sweeps + owner)
    seen = np.zeros(len(which), np.bool_)
    for up in (-1, 0, 1):
        for right in (-1, 0, 1):
            first = (place[which] + up * width + right) * sweeps
            many = np.searchsorted(pairs, first + sweeps) - np.searchsorted(pairs, first)
            own = first + owner[which]
            row = np.minimum(np.searchsorted(pairs, own), len(pairs) - 1)
            seen |= many > (pairs[row] == own)
    return seen
