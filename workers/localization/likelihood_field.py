"""A likelihood field: how well the ends of laser beams fit a map.

After Thrun, Burgard and Fox, "Probabilistic Robotics" (2005), section 6.4: the likelihood falls with the
distance to the nearest obstacle, which a distance transform gives for all places at once.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT

BATCH = 50_000  # number of ends looked up at once, so that they fit into the processor's caches
SURFACE_M = 0.3  # this close to its end, a beam may touch the obstacle that it ends at
HALF_A_TURN = np.pi


class MapWithoutRoom(ValueError):
    """A map without free or without occupied cells: no robot can be localised in it."""


class LikelihoodField:
    """The logarithm of the likelihood of a beam ending in each cell of a map.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        deviation_m: Standard deviation of a beam's end, from noise, cell size, and errors of the map.
        outliers: Likelihood of an end far from all obstacles (people, doors), relative to one on an
            obstacle.

    Raises:
        MapWithoutRoom: The map has no free or no occupied cell.

    Attributes:
        worst: The smallest possible logarithm of a likelihood.
    """

    def __init__(
        self,
        cells: NDArray[np.int8],
        resolution_m: float,
        corner_xy_m: ArrayLike,
        deviation_m: float = 0.1,
        outliers: float = 0.1,
    ) -> None:
        occupied = cells >= OCCUPIED_PERCENT
        free = (cells >= 0) & ~occupied
        if not free.any() or not occupied.any():
            raise MapWithoutRoom("a map to localise in needs free and occupied cells")
        self.resolution_m = resolution_m
        self.corner_xy_m = np.asarray(corner_xy_m, float)
        # One more cell on each side represents everything outside.
        self._occupied = np.pad(occupied, 1)
        distance = ndimage.distance_transform_edt(~np.pad(occupied, 1)) * resolution_m
        self.distance_m = distance.astype(np.float32)
        hit = np.exp(-0.5 * (distance / deviation_m) ** 2)
        self._log = np.log(np.maximum(hit, outliers)).astype(np.float32)
        self.worst = float(np.log(outliers))
        self._log[[0, -1]] = self._log[:, [0, -1]] = self.worst
        self._free_cells = np.argwhere(free)

    @property
    def free_m2(self) -> float:
        """Return the area where the robot may be."""
        return len(self._free_cells) * self.resolution_m**2

    @property
    def diagonal_m(self) -> float:
        """Return how far two places of the map can be apart."""
        return math.hypot(*self._occupied.shape) * self.resolution_m

    def random_poses(self, count: int, random: np.random.Generator) -> NDArray[np.float64]:
        """Draw poses uniformly from free space: `(count, 3)`, m and rad, map frame."""
        cells = self._free_cells[random.integers(len(self._free_cells), size=count)]
        xy = (cells[:, ::-1] + random.random((count, 2))) * self.resolution_m + self.corner_xy_m
        return np.column_stack([xy, random.uniform(-HALF_A_TURN, HALF_A_TURN, count)])

    def log_likelihoods(self, poses: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return for each pose the mean over all beams of the logarithm of their likelihood.

        A pose inside an obstacle is impossible and gets `worst`.

        Args:
            poses: `(N, 3)`, m and rad, map frame.
            ends: `(B, 2)`, m, where beams ended, in the frame of the robot.

        Returns:
            `(N,)`, from `worst` to 0.
        """
        result = np.empty(len(poses))
        log = self._log.ravel()
        at_once = max(1, BATCH // max(1, len(ends)))
        for begin in range(0, len(poses), at_once):
            batch = slice(begin, begin + at_once)
            result[batch] = log.take(self._end_cells(poses[batch], ends)).mean(axis=1)
        result[self._occupied.ravel()[self._cells(poses[:, 0], poses[:, 1])]] = self.worst
        return result

    def blocked(self, poses: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return for each pose `(N, 3)` the share `(N,)` of beams that would pass through an obstacle.

        Follows each beam in steps as long as the distance to the nearest obstacle (sphere tracing, Hart, The
        Visual Computer 12, 1996).

        Args:
            poses: `(N, 3)`, m and rad, map frame.
            ends: `(B, 2)`, m, robot's frame: how far the beams saw.
        """
        result = np.empty(len(poses))
        at_once = max(1, BATCH // max(1, len(ends)))
        for begin in range(0, len(poses), at_once):
            result[begin : begin + at_once] = self._blocked(poses[begin : begin + at_once], ends)
        return result

    def _blocked(self, poses: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
        lengths = np.hypot(ends[:, 0], ends[:, 1])
        bearings = (poses[:, 2:] + np.arctan2(ends[:, 1], ends[:, 0])).ravel()
        cos, sin = np.cos(bearings), np.sin(bearings)
        x, y = np.repeat(poses[:, 0], len(ends)), np.repeat(poses[:, 1], len(ends))
        left = np.tile(lengths - SURFACE_M, len(poses))
        hits = np.zeros(len(poses))
        robot = np.repeat(np.arange(len(poses)), len(ends))
        distance = self.distance_m.ravel()
        while len(left):
            room = distance.take(self._cells(x, y))
            hit = room < 0.5 * self.resolution_m
            np.add.at(hits, robot[hit & (left > 0)], 1)
            # A cell's distance is exact only at its middle.
            step = np.maximum(room - self.resolution_m, self.resolution_m)
            left = left - step
            on = ~hit & (left > 0)
            x, y = (x + step * cos)[on], (y + step * sin)[on]
            left, cos, sin, robot = left[on], cos[on], sin[on], robot[on]
        return hits / len(ends)

    def distances_m(self, pose: ArrayLike, ends: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return how far the ends `(B, 2)` lie from the nearest obstacle if the robot is at a pose."""
        distances: NDArray[np.float32] = self.distance_m.ravel()[
            self._end_cells(np.asarray(pose, float)[None], ends)[0]
        ]
        return distances

    def _end_cells(self, poses: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the cells in which the ends `(B, 2)` lie for each pose: `(N, B)`."""
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        beams = np.column_stack([ends, np.ones(len(ends))]).T
        x = np.column_stack([cos, -sin, poses[:, 0]]) @ beams
        y = np.column_stack([sin, cos, poses[:, 1]]) @ beams
        return self._cells(x, y)

    def _cells(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the index of the cell around each place, in the flattened arrays."""
        height, width = self._occupied.shape
        column = self._number(x_m - self.corner_xy_m[0], width)
        cells: NDArray[np.int64] = self._number(y_m - self.corner_xy_m[1], height) * width + column
        return cells

    def _number(self, offset_m: NDArray[np.float64], size: int) -> NDArray[np.int64]:
        """Return the number of the row or column at an offset; overwrites the offset."""
        offset_m /= self.resolution_m
        # With 1 added for the margin all relevant values are positive, so truncation is the floor.
        offset_m += 1
        np.clip(offset_m, 0, size - 1, out=offset_m)
        return offset_m.astype(np.int64)
