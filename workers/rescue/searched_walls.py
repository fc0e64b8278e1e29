"""Which walls the camera has seen well enough to rule out a missed victim."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT
from robbie_robots.workers.planar_pose import wrap_angle

KEY_M = 0.1
"""Searched walls are stored in squares with this edge, so that small shifts of the map do not matter."""
KEY_SPAN = 1 << 20
ALL_EIGHT = np.ones((3, 3), dtype=bool)
NOTHING, UNSEARCHED, SEARCHED = -1, 0, 100


@dataclass(frozen=True)
class CameraView:
    """How well a camera sees.

    Attributes:
        margin_m: margin at the image's sides, because a tag must be completely visible.
        near_m: minimum distance; nearer tags do not fit into the image.
        far_m: maximum distance; farther tags are too small.
        slant_rad: maximum angle to the wall's normal.
    """

    margin_m: float = 0.16
    near_m: float = 0.35
    far_m: float = 2.4
    slant_rad: float = 0.95


class WallFronts:
    """The free cells of a map in front of its walls, where victims can hang.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.

    Attributes:
        cells: `(N, 2)`, (row, column).
        middles_m: `(N, 2)`, m, map frame.
        normals: `(N, 2)`, unit vectors away from the wall.
    """

    def __init__(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        self._corner = np.asarray(corner_xy_m, float)
        self._resolution_m = resolution_m
        self._occupied = cells >= OCCUPIED_PERCENT
        self.shape = cells.shape
        free = (cells >= 0) & ~self._occupied
        front = free & ndimage.binary_dilation(self._occupied, ALL_EIGHT)
        self.cells = np.argwhere(front)
        self.middles_m = (self.cells[:, ::-1] + 0.5) * resolution_m + self._corner
        smooth = ndimage.gaussian_filter(self._occupied.astype(np.float32), 1.5)
        rise = [ndimage.sobel(smooth, axis)[front] for axis in (1, 0)]
        normals = -np.stack(rise, axis=1).astype(float)
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)

    def keys(self) -> NDArray[np.int64]:
        """Return the number of the `KEY_M` square that each front cell lies in."""
        column, row = np.floor(self.middles_m / KEY_M).astype(np.int64).T
        keys: NDArray[np.int64] = row * KEY_SPAN + column
        return keys

    def seen_from(self, eye: ArrayLike, half_width_rad: float, view: CameraView) -> NDArray[np.bool_]:
        """Return which front cells a camera sees well `(N,)`.

        Args:
            eye: x, y (m) and heading (rad) of the optical axis, map frame.
            half_width_rad: half the camera's horizontal field of view.
            view: how well it sees.
        """
        x, y, heading = np.asarray(eye, float)
        offset = self.middles_m - (x, y)
        distance = np.hypot(*offset.T)
        bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - heading)
        towards_eye = -(offset * self.normals).sum(axis=1)
        beside_rad = half_width_rad - np.arctan(view.margin_m / np.maximum(distance, 1e-9))
        seen: NDArray[np.bool_] = (
            (distance >= view.near_m) & (distance <= view.far_m) & (np.abs(bearing) <= beside_rad)
        )
        seen &= towards_eye >= distance * np.cos(view.slant_rad)
        seen[seen] = self.is_in_sight(np.array([x, y]), self.middles_m[seen])
        return seen

    def is_in_sight(self, eye_xy_m: NDArray[np.float64], points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether each point `(N, 2)` can be seen from a place with no wall between; m, map frame."""
        if len(points_m) == 0:
            return np.zeros(0, dtype=bool)
        offset = points_m - eye_xy_m
        longest_m = float(np.hypot(*offset.T).max())
        # The ray may graze the last cells before a wall's front.
        share = np.linspace(0.0, 1.0, int(longest_m / self._resolution_m * 1.5) + 2)[:-2]
        way = eye_xy_m + share[:, None, None] * offset
        column, row = np.floor((way - self._corner) / self._resolution_m).astype(int).transpose(2, 0, 1)
        inside = (row >= 0) & (row < self.shape[0]) & (column >= 0) & (column < self.shape[1])
        hit = self._occupied[np.where(inside, row, 0), np.where(inside, column, 0)] & inside
        is_hidden: NDArray[np.bool_] = hit.any(axis=0)
        return ~is_hidden


class WallMemory:
    """Remembers which walls were searched.

    Args:
        view: how well the camera sees.
    """

    def __init__(self, view: CameraView | None = None) -> None:
        self._view = view or CameraView()
        self._searched = np.zeros(0, np.int64)

    def look(self, fronts: WallFronts, eye: ArrayLike, half_width_rad: float) -> None:
        """Take an image into account.

        Args:
            fronts: where victims can hang.
            eye: x, y (m) and heading (rad) of the camera's optical axis, map frame.
            half_width_rad: half the image's field of view: the angle to each side of the optical axis.
        """
        new = fronts.keys()[fronts.seen_from(eye, half_width_rad, self._view)]
        self._searched = np.union1d(self._searched, new)

    def is_searched(self, fronts: WallFronts) -> NDArray[np.bool_]:
        """Return which front cells were searched `(N,)`."""
        return np.isin(fronts.keys(), self._searched)

    def grid(self, fronts: WallFronts) -> NDArray[np.int8]:
        """Return a grid like the map's `(H, W)`: -1 not in front of a wall, 0 not searched, 100 searched."""
        grid = np.full(fronts.shape, NOTHING, np.int8)
        grid[tuple(fronts.cells.T)] = np.where(self.is_searched(fronts), SEARCHED, UNSEARCHED)
        return grid

    def state(self) -> dict[str, Any]:
        """Return the memory as plain data."""
        return {"searched": self._searched}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._searched = np.array(state["searched"], np.int64)
