"""Where another robot's map lies in this robot's map, and how sure that is.

The search is exhaustive: for each heading, the correlation of the two maps by Fourier transforms gives the
score of all shifts at once (Lewis, "Fast normalized cross-correlation", 1995; for maps of robots, Birk and
Carpin, "Merging occupancy grid maps from multiple robots", Proceedings of the IEEE 2006). A pose scores for
walls on walls, and loses for walls where the other robot saw free ground. As the whole space is searched, the
best pose that lies elsewhere is known, too: if it is almost as good, the match is ambiguous and refused.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage

from robbie_robots.workers.mapping.correlative_search import ScoreField, SearchWindow, search
from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT, distance_cells
from robbie_robots.workers.planar_pose import rotate, transform_points, wrap_angle

Points = NDArray[np.float64]
Scores = NDArray[np.floating[Any]]
_Value = TypeVar("_Value", np.bool_, np.int8, np.float64)

COARSE_M = 0.1  # cells of the exhaustive search
MOST_CELLS = 320  # along a side of each map in that search; larger maps get larger cells
HEADINGS = 120
WALL_BLUR = 2.5  # raises the blurred line of a wall to 1
AROUND_ROBOT_M = 0.25  # a robot leaves walls this far beyond its radius from where it was heard to be
FREE_FROM_WALL_M = 0.2  # ground this far from walls is surely free, even if a map is a little off
ON_WALL_M = 0.12  # a wall of one map lies on a wall of the other
BLOCK = 4  # shifts along a side that share a score for the next best pose
ELSEWHERE_M, ELSEWHERE_RAD = 0.8, 0.35
FINE_M, FINE_BLUR_M = 0.025, 0.06
MOST_POINTS = 6000
KNOWN_WINDOW = SearchWindow(0.5, 0.15)
"""How far a known start may be wrong."""
FOUND_WINDOW = SearchWindow(0.2, math.tau / HEADINGS)


@dataclass(frozen=True)
class GridMap:
    """A map.

    Attributes:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: `(2,)`, outer corner of cell (0, 0), m.
    """

    cells: NDArray[np.int8]
    resolution_m: float
    corner_xy_m: ArrayLike

    def walls(self) -> Points:
        """Return the middles of the occupied cells `(N, 2)`, m."""
        return self.middles(self.cells >= OCCUPIED_PERCENT)

    def free(self) -> Points:
        """Return the middles of the cells that are surely free `(N, 2)`, m."""
        return self.middles(self._surely_free())

    def is_free(self, points: Points) -> NDArray[np.bool_]:
        """Return which points `(N, 2)`, m, lie on ground that is surely free."""
        return self._look_up(self._surely_free(), points, outside=False)

    def wall_distance_m(self, points: Points) -> NDArray[np.float64]:
        """Return the distance of points `(N, 2)`, m, from the nearest wall; +inf outside the map."""
        distance_m = distance_cells(self.cells >= OCCUPIED_PERCENT) * self.resolution_m
        return self._look_up(distance_m, points, outside=np.inf)

    def occupancy(self, points: Points) -> NDArray[np.int8]:
        """Return the occupancy at points `(N, 2)`, m; -1 outside the map."""
        return self._look_up(self.cells, points, outside=-1)

    def _surely_free(self) -> NDArray[np.bool_]:
        is_wall = self.cells >= OCCUPIED_PERCENT
        is_far = distance_cells(is_wall) * self.resolution_m >= FREE_FROM_WALL_M
        surely: NDArray[np.bool_] = (self.cells >= 0) & ~is_wall & is_far
        return surely

    def middles(self, chosen: NDArray[np.bool_]) -> Points:
        """Return the middles `(N, 2)`, m, of chosen cells `(H, W)`."""
        rows, columns = np.nonzero(chosen)
        middles: Points = (np.stack([columns, rows], axis=1) + 0.5) * self.resolution_m + np.asarray(
            self.corner_xy_m, float
        )
        return middles

    def _look_up(self, grid: NDArray[_Value], points: Points, outside: float) -> NDArray[_Value]:
        column, row = np.floor((points - np.asarray(self.corner_xy_m)) / self.resolution_m).astype(int).T
        inside = (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
        found = np.full(len(points), outside, grid.dtype)
        found[inside] = grid[row[inside], column[inside]]
        return found


@dataclass(frozen=True)
class Trust:
    """When an alignment counts as sure.

    Attributes:
        least_walls_m: Length of wall that lies on walls of the other map.
        least_agreement: Share of the walls, of those that the other map knows, that lie on its walls.
        most_ambiguous: Score of the best pose elsewhere, as a share of the best score.
    """

    least_walls_m: float = 5.0
    least_agreement: float = 0.85
    most_ambiguous: float = 0.75


@dataclass(frozen=True)
class Alignment:
    """Where the other map lies.

    Attributes:
        pose: x (m), y (m), heading (rad) of the other map's frame in this map.
        walls_m: Length of wall that lies on walls of the other map.
        agreement: 0 to 1: how much of the walls in the common area lies on walls.
        ambiguity: 0 to 1: score of the best pose elsewhere, as a share of this one's; 0 with a known start.
        doubt: Why it is not sure; '' if it is.
    """

    pose: Points
    walls_m: float
    agreement: float
    ambiguity: float
    doubt: str

    @property
    def is_sure(self) -> bool:
        """Whether the maps may be merged by it."""
        return not self.doubt


def align(
    own: GridMap, other: GridMap, known: ArrayLike | None = None, trust: Trust | None = None
) -> Alignment:
    """Find the pose of another robot's map in this robot's map.

    Args:
        own: this robot's map.
        other: the other robot's map.
        known: its pose (x m, y m, heading rad) as far as known, with an error of at most `KNOWN_WINDOW`;
            None: it may lie anywhere, at any heading.
        trust: when the result counts as sure.

    Returns:
        The best alignment; ask its `is_sure`. A known pose is returned as it is if the maps do not confirm a
        better one.
    """
    walls, other_walls = own.walls(), other.walls()
    start = np.zeros(3) if known is None else np.asarray(known, float)
    if not len(walls) or not len(other_walls):
        return Alignment(start, 0.0, 0.0, 0.0, "a map has no walls")
    ambiguity, window = 0.0, KNOWN_WINDOW
    if known is None:
        start, ambiguity = _search_everywhere(own, other)
        window = FOUND_WINDOW
    field = ScoreField(_thinned(walls), FINE_M, FINE_BLUR_M, window.distance_m)
    found = search(field, _thinned(other_walls), start, window)
    pose = start if found is None else found.pose
    pose[2] = wrap_angle(pose[2])
    alignment = _judged(own, other, pose, ambiguity, trust or Trust())
    if known is not None and not alignment.is_sure:
        return Alignment(
            np.asarray(known, float), alignment.walls_m, alignment.agreement, 0.0, alignment.doubt
        )
    return alignment


def merged(own: GridMap, others: list[tuple[GridMap, Points]]) -> GridMap:
    """Return one map of several; where this robot's map knows a cell, it counts.

    Args:
        own: this robot's map. The result has its resolution, and its cells lie on those of the result.
        others: other robots' maps, each with its pose (x m, y m, heading rad) in this robot's map.
    """
    corner = np.asarray(own.corner_xy_m, float)
    low, high = np.zeros(2), np.array(own.cells.shape[::-1], float)
    for other, pose in others:
        size = np.array(other.cells.shape[::-1]) * other.resolution_m
        corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * size + np.asarray(other.corner_xy_m)
        there = (transform_points(pose, corners) - corner) / own.resolution_m
        low, high = np.minimum(low, there.min(axis=0)), np.maximum(high, there.max(axis=0))
    first, last = np.floor(low).astype(int), np.ceil(high).astype(int)
    width, height = (last - first).tolist()
    cells = np.full((height, width), -1, np.int8)
    left, bottom = (-first).tolist()
    cells[bottom : bottom + own.cells.shape[0], left : left + own.cells.shape[1]] = own.cells
    result = GridMap(cells, own.resolution_m, corner + first * own.resolution_m)
    for other, pose in others:
        unknown = cells < 0
        backwards = rotate(-pose[2], result.middles(unknown) - pose[:2])
        cells[unknown] = other.occupancy(backwards)
    return result


def without_robot(
    grid: GridMap, places_xy_m: Points, radius_m: float, other: GridMap | None, pose: Points
) -> GridMap:
    """Return a map without the walls that were another robot: ground on which it stands or has stood is free.

    The other robot's map does not show that robot. So a wall a little farther from where it was is no wall
    either, if that map shows free ground there.

    Args:
        grid: the map.
        places_xy_m: `(N, 2)`, m, in the map's frame: where the robot is or was.
        radius_m: of the robot, as the map shows it.
        other: the robot's own map. None: not known.
        pose: `(3,)`, of the frame of that map in the map's frame, m and rad.
    """
    cells = np.floor((places_xy_m - np.asarray(grid.corner_xy_m, float)) / grid.resolution_m).astype(np.int64)
    height, width = grid.cells.shape
    inside = ((cells >= 0) & (cells < (width, height))).all(axis=1)
    if not inside.any():
        return grid
    is_place = np.zeros(grid.cells.shape, bool)
    is_place[cells[inside, 1], cells[inside, 0]] = True
    away_m = distance_cells(is_place) * grid.resolution_m
    is_wall = grid.cells >= OCCUPIED_PERCENT
    is_robot = is_wall & (away_m <= radius_m)
    if other is not None:
        is_near = is_wall & ~is_robot & (away_m <= radius_m + AROUND_ROBOT_M)
        is_robot[is_near] = other.is_free(rotate(-pose[2], grid.middles(is_near) - pose[:2]))
    return GridMap(np.where(is_robot, 0, grid.cells).astype(np.int8), grid.resolution_m, grid.corner_xy_m)


def _judged(own: GridMap, other: GridMap, pose: Points, ambiguity: float, trust: Trust) -> Alignment:
    """Return the alignment at a pose, with the reason to doubt it."""
    theirs = transform_points(pose, other.walls())
    ours = rotate(-pose[2], own.walls() - pose[:2])
    on_wall = int((own.wall_distance_m(theirs) <= ON_WALL_M).sum())
    against = int(own.is_free(theirs).sum()) + int(other.is_free(ours).sum())
    walls_m = on_wall * other.resolution_m
    agreement = on_wall / max(on_wall + against, 1)
    doubt = ""
    if walls_m < trust.least_walls_m:
        doubt = f"only {walls_m:.1f} m of wall are on both maps"
    elif agreement < trust.least_agreement:
        doubt = f"only {agreement:.0%} of the walls lie on walls of the other map"
    elif ambiguity > trust.most_ambiguous:
        doubt = f"another pose fits almost as well ({ambiguity:.0%})"
    return Alignment(pose, walls_m, agreement, ambiguity, doubt)


def _search_everywhere(own: GridMap, other: GridMap) -> tuple[Points, float]:
    """Return the best of all poses, and the score of the best pose elsewhere as a share of its score."""
    extent_m = max(max(one.cells.shape) * one.resolution_m for one in (own, other))
    cell_m = max(COARSE_M, extent_m / MOST_CELLS)
    walls, low = _raster(own.walls(), cell_m)
    free, _ = _raster(own.free(), cell_m, low, walls.shape)
    near_wall = np.minimum(ndimage.gaussian_filter(walls, 1.0, truncate=2.0) * WALL_BLUR, 1.0)
    their_walls, their_free = other.walls(), other.free()
    middle = their_walls.mean(axis=0)
    reach_m = float(np.hypot(*(np.concatenate([their_walls, their_free]) - middle).T).max())
    half = math.ceil(reach_m / cell_m) + 1
    first, square = np.full(2, -half, np.int64), (2 * half + 1, 2 * half + 1)
    height, width = (fft.next_fast_len(size + square[0], real=True) for size in walls.shape)
    wanted, unwanted = fft.rfft2(near_wall - free, (height, width)), fft.rfft2(walls, (height, width))
    turns = np.arange(HEADINGS) * math.tau / HEADINGS
    tops = np.empty((HEADINGS, -(-height // BLOCK), -(-width // BLOCK)))
    best_score, best = -np.inf, (0, 0, 0)
    for number, turn in enumerate(turns):
        theirs, _ = _raster(rotate(turn, their_walls - middle), cell_m, first, square)
        ground, _ = _raster(rotate(turn, their_free - middle), cell_m, first, square)
        spectrum = wanted * fft.rfft2(theirs, (height, width)).conj()
        spectrum -= unwanted * fft.rfft2(ground, (height, width)).conj()
        scores: Scores = fft.irfft2(spectrum, (height, width))
        tops[number] = _block_maxima(scores)
        place = int(scores.argmax())
        if scores.flat[place] > best_score:
            best_score, best = float(scores.flat[place]), (number, *divmod(place, width))
    number, row, column = best
    # Shifts are cyclic: those beyond this robot's map are negative.
    shift = [column - width * (column >= walls.shape[1]), row - height * (row >= walls.shape[0])]
    centre = (low + shift - first) * cell_m
    pose = np.array([*(centre - rotate(turns[number], middle[None])[0]), turns[number]])
    return pose, _best_elsewhere(tops, best, (height, width), cell_m) / max(best_score, 1e-9)


def _best_elsewhere(tops: Points, best: tuple[int, int, int], size: tuple[int, int], cell_m: float) -> float:
    """Return the greatest score among the poses that lie away from the best one; at least 0.

    Args:
        tops: the greatest scores `(headings, rows, columns)` of each heading and block of shifts.
        best: heading, row and column of the best pose; the latter two in cells.
        size: rows and columns of the cyclic shifts, in cells.
        cell_m: edge of a cell.
    """
    rows, columns = (
        _cyclic(np.arange(count) * BLOCK + BLOCK / 2 - centre, cells)
        for count, centre, cells in zip(tops.shape[1:], best[1:], size, strict=True)
    )
    is_far = np.hypot(rows[:, None], columns[None]) * cell_m > ELSEWHERE_M
    headings = np.arange(len(tops)) * math.tau / len(tops)
    is_turned = np.abs(wrap_angle(headings - headings[best[0]])) > ELSEWHERE_RAD
    return float(np.where(is_far | is_turned[:, None, None], tops, 0.0).max())


def _cyclic(offset: Points, size: int) -> Points:
    wrapped: Points = (offset + size / 2) % size - size / 2
    return wrapped


def _raster(
    points: Points, cell_m: float, low: NDArray[np.int64] | None = None, shape: tuple[int, ...] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return which cells `(H, W)` hold points, 1 or 0, and (column, row) of the first cell in the plane."""
    cells = np.floor(points / cell_m).astype(np.int64)
    if low is None or shape is None:
        low = cells.min(axis=0)
        shape = tuple((cells.max(axis=0) - low + 1).tolist()[::-1])
    columns, rows = (cells - low).T
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    raster = np.zeros(shape, np.float32)
    raster[rows[inside], columns[inside]] = 1.0
    return raster, low


def _block_maxima(scores: Scores) -> Points:
    """Return the greatest score of each block of shifts."""
    height, width = (-(-size // BLOCK) * BLOCK for size in scores.shape)
    padded = np.full((height, width), -np.inf)
    padded[: scores.shape[0], : scores.shape[1]] = scores
    maxima: Points = padded.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).max(axis=(1, 3))
    return maxima


def _thinned(points: Points) -> Points:
    return points[:: -(-len(points) // MOST_POINTS)]
