"""Where posts stand: from the direction in which a board was seen, and what the laser sees there."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

Points = NDArray[np.float64]

ASIDE_M, ASIDE_PER_M = 0.10, 0.025
"""A post is at most this far beside the ray through the middle of its board."""
POST_WIDTH_M = 0.32
"""Whatever is wider on the map or in a scan is no post."""
APART_M = 0.45
"""Nothing else is as near as this to a post."""
MIN_EDGE_M, MAX_EDGE_M = 0.25, 0.7
"""Boards have edges between these; so the height of one in an image tells roughly how far away it is."""
BEFORE_M = 0.3
OCCUPIED_PERCENT = 50


@dataclass(frozen=True)
class SignView:
    """What the laser saw, and from where the camera looked.

    Attributes:
        eye: x, y (m) of the camera and the direction (rad) in which it looks, map frame.
        half_width_rad: half the horizontal field of view.
        points_m: (N, 2), ends of the laser's beams, map frame.
    """

    eye: tuple[float, float, float]
    half_width_rad: float
    points_m: Points

    def to(self, place_xy_m: ArrayLike) -> tuple[float, float]:
        """Return distance (m) and direction (rad) from the camera to a place."""
        x, y = (np.asarray(place_xy_m, float) - self.eye[:2]).tolist()
        return math.hypot(x, y), math.atan2(y, x)

    def shows(self, place_xy_m: ArrayLike, min_m: float, max_m: float) -> bool:
        """Return whether the camera sees a place, if it is between two distances and nothing is before it."""
        distance_m, direction_rad = self.to(place_xy_m)
        beside_rad = abs(math.remainder(direction_rad - self.eye[2], math.tau))
        if not min_m <= distance_m <= max_m or beside_rad > 0.85 * self.half_width_rad:
            return False
        along, across = self._along(self.points_m, direction_rad)
        before = (along > 0.05) & (along < distance_m - BEFORE_M) & (across < ASIDE_M)
        return not before.any()

    def post_along(
        self, direction_rad: float, min_m: float, max_m: float, known_m: Points | None = None
    ) -> Points | None:
        """Return the post (2,), m, map frame, in a direction and between two distances.

        None if there is none, or another one that may carry the board as well.

        Args:
            direction_rad: map frame.
            min_m: distance.
            max_m: distance.
            known_m: (N, 2), posts on the map, m; beams may miss a far one.
        """
        chosen, along = self._between(self.points_m, direction_rad, min_m, max_m)
        found: Points | None = None
        for number in chosen[np.argsort(along[chosen])]:
            if found is not None and math.dist(found, self.points_m[number]) < APART_M:
                continue
            away = np.hypot(*(self.points_m - self.points_m[number]).T)
            around = self.points_m[away < APART_M]
            if np.ptp(around, axis=0).max() <= POST_WIDTH_M:
                if found is not None:
                    return None
                found = np.asarray(around.mean(axis=0))
        if found is not None and known_m is not None:
            beside, _ = self._between(known_m, direction_rad, min_m, max_m)
            if (np.hypot(*(known_m[beside] - found).T) > APART_M).any():
                return None
        return found

    def _between(
        self, points_m: Points, direction_rad: float, min_m: float, max_m: float
    ) -> tuple[NDArray[np.intp], Points]:
        """Return which points are near a ray and between two distances, and how far along it all are."""
        along, across = self._along(points_m, direction_rad)
        beside = across < ASIDE_M + ASIDE_PER_M * np.maximum(along, 0.0)
        return np.flatnonzero(beside & (along > min_m) & (along < max_m)), along

    def _along(self, points_m: Points, direction_rad: float) -> tuple[Points, Points]:
        """Return how far along a ray points are, and how far beside it."""
        offset = points_m - self.eye[:2]
        cos, sin = math.cos(direction_rad), math.sin(direction_rad)
        along: Points = offset[:, 0] * cos + offset[:, 1] * sin
        across: Points = np.abs(offset[:, 1] * cos - offset[:, 0] * sin)
        return along, across


def distances_m(height_px: float, focal_px: float) -> tuple[float, float]:
    """Return between which distances a board is that appears with a height."""
    return MIN_EDGE_M * focal_px / height_px, MAX_EDGE_M * focal_px / height_px


def posts_on(cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> Points:
    """Return the small things that stand alone on a map: (N, 2), m, map frame.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
    """
    occupied = cells >= OCCUPIED_PERCENT
    # Cells of one thing touch, or almost.
    joined = ndimage.binary_dilation(occupied, np.ones((3, 3), bool))
    labels, _ = ndimage.label(joined)
    found = []
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        size_m = (max(side.stop - side.start for side in box) - 2) * resolution_m
        if size_m > POST_WIDTH_M:
            continue
        rows, columns = np.nonzero(occupied[box] & (labels[box] == number))
        middle = np.array([columns.mean() + box[1].start, rows.mean() + box[0].start]) + 0.5
        if _stands_free(cells, middle, resolution_m):
            found.append(middle * resolution_m + np.asarray(corner_xy_m, float))
    return np.array(found).reshape(-1, 2)


def _stands_free(cells: NDArray[np.int8], middle: Points, resolution_m: float) -> bool:
    """Return whether most of the surroundings of a thing are known to be free: others are parts of walls."""
    reach = round(APART_M / resolution_m)
    column, row = middle.astype(int).tolist()
    around = cells[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return bool((around[around >= 0] < OCCUPIED_PERCENT).sum() > 0.5 * around.size)
