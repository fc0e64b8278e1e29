"""Find the pose at which a sweep fits a set of points best, over a whole window of poses.

Correlative scan matching (Olson, "Real-time correlative scan matching", ICRA 2009). The search is branch and
bound over a pyramid of the score's maxima (Hess, Kohler, Rapp and Andor, "Real-time loop closure in 2D LIDAR
SLAM", ICRA 2016). It finds the window's global maximum, exact to one cell.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import wrap_angle

BLURS = 3  # radius of a reference point's blur, in standard deviations
COARSEST = 4  # initial branches along a side of the window
BATCH = 256  # branches scored together, because numpy's cost is per call


@dataclass(frozen=True)
class SearchWindow:
    """The poses to search: this far on each side of the first guess.

    Attributes:
        distance_m: In x and in y.
        angle_rad: In heading.
        doubt_per_m2: Subtracted from the score for each m² of squared distance from the first guess.
        doubt_per_rad2: Subtracted from the score for each rad² of squared angle from the first guess.
    """

    distance_m: float
    angle_rad: float
    doubt_per_m2: float = 0.0
    doubt_per_rad2: float = 0.0


@dataclass(frozen=True)
class Found:
    """The best pose of a window (x m, y m, heading rad), and its score, 0 to 1, minus the window's doubt."""

    pose: NDArray[np.float64]
    score: float


@dataclass(frozen=True)
class Around:
    """Poses near a pose: this far on each side of it, in x and y (m) and in heading (rad).

    Attributes:
        pose: The pose.
        distance_m: Greatest distance in x and in y.
        angle_rad: Greatest turn.
        along: `(2,)`, a unit vector. How far a pose lies off in this direction does not matter.
    """

    pose: NDArray[np.float64]
    distance_m: float
    angle_rad: float
    along: NDArray[np.float64] | None = None

    def holds(self, poses: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of the poses `(N, 3)` are near."""
        off = (poses - self.pose)[:, :2]
        if self.along is not None:
            off = off - (off @ self.along)[:, None] * self.along
        turned = np.abs(wrap_angle(poses[:, 2] - self.pose[2]))
        holds: NDArray[np.bool_] = (np.abs(off).max(axis=1) <= self.distance_m) & (turned <= self.angle_rad)
        return holds


class ScoreField:
    """How well a point at each place of the plane fits a set of reference points: 1 on them, 0 far away.

    Args:
        reference: Points `(M, 2)`, m.
        resolution_m: Edge of a cell.
        blur_m: Standard deviation of the fit over distance.
        reach_m: How far the search may move a point from its first place.
    """

    def __init__(self, reference: ArrayLike, resolution_m: float, blur_m: float, reach_m: float) -> None:
        reference = np.asarray(reference, float)
        self.resolution_m = resolution_m
        # Points beyond the margin are moved to its edge, where no search step may reach a score.
        self.margin = int(np.ceil((2 * reach_m + 4 * blur_m) / resolution_m)) + 2
        self.corner = np.floor(reference.min(axis=0) / resolution_m).astype(np.int64) - self.margin
        cells = np.floor(reference / resolution_m).astype(np.int64) - self.corner
        width, height = cells.max(axis=0) + self.margin + 1
        field = np.zeros((height, width), dtype=np.float32)
        rows, columns = np.divmod(np.unique(cells[:, 1] * width + cells[:, 0]), width)
        reach = int(np.ceil(BLURS * blur_m / resolution_m))
        for up in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                fit = np.float32(np.exp(-0.5 * (up * up + right * right) * (resolution_m / blur_m) ** 2))
                place = rows + up, columns + right
                field[place] = np.maximum(field[place], fit)
        self._levels = [field]

    def level(self, number: int) -> NDArray[np.float32]:
        """Return the greatest score within `2 ** number` cells towards +x and +y of each cell."""
        while len(self._levels) <= number:
            field, half = self._levels[-1], 2 ** (len(self._levels) - 1)
            wider = field.copy()
            np.maximum(wider[:, :-half], field[:, half:], out=wider[:, :-half])
            field = wider.copy()
            np.maximum(wider[:-half], field[half:], out=wider[:-half])
            self._levels.append(wider)
        return self._levels[number]


def search(
    field: ScoreField,
    points: ArrayLike,
    guess: ArrayLike,
    window: SearchWindow,
    least_score: float = 0.0,
    apart_from: Around | None = None,
) -> Found | None:
    """Search the window for the pose at which the points fit best.

    Args:
        field: The score of places.
        points: `(N, 2)`, m, in the frame of the pose sought.
        guess: Centre of the window (x, y, heading) in the field's frame.
        window: Its size; the field's reach must cover its distance.
        least_score: Poses below this score are ignored.
        apart_from: Poses to leave out, to find the second-best place.

    Returns:
        The best pose, or None if none reaches `least_score`.
    """
    points, guess = np.asarray(points, float), np.asarray(guess, float)
    turns, bases = _turned(field, points, guess, window)
    side = int(np.ceil(window.distance_m / field.resolution_m))
    top = max(0, int(np.ceil(np.log2((2 * side + 1) / COARSEST))))
    step = 2**top
    shifts = np.arange(-side, side + 1, step)
    grid = np.stack(np.meshgrid(np.arange(len(turns)), shifts, shifts, indexing="ij"), axis=-1).reshape(-1, 3)
    best, best_score = None, least_score
    # Level, branches, and their bounds where already known.
    stack: list[tuple[int, NDArray[np.int64], NDArray[np.float64] | None]] = [(top, grid, None)]
    while stack:
        level, branches, bounds = stack.pop()
        if bounds is None:
            bounds = _scores(field, level, bases, branches) - _doubt(field, level, branches, turns, window)
            order = np.argsort(-bounds)
            branches, bounds = branches[order], bounds[order]
        alive = int(np.searchsorted(-bounds, -best_score))
        if alive == 0:
            continue
        if level == 0:
            if apart_from is not None:
                poses = guess + np.column_stack(
                    [branches[:alive, 1:] * field.resolution_m, turns[branches[:alive, 0]]]
                )
                others = np.flatnonzero(~apart_from.holds(poses))
                if len(others) == 0:
                    continue
                branches, bounds = branches[others], bounds[others]
            best, best_score = branches[0], float(bounds[0])
            continue
        if alive > BATCH:
            stack.append((level, branches[BATCH:alive], bounds[BATCH:alive]))
        stack.append((level - 1, _split(branches[: min(alive, BATCH)], level, side), None))
    if best is None:
        return None
    shift = best[1:] * field.resolution_m
    return Found(guess + np.array([*shift, turns[best[0]]]), best_score)


def _turned(
    field: ScoreField, points: NDArray[np.float64], guess: NDArray[np.float64], window: SearchWindow
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the headings to try (rad from the guess) and the points' cells at each, `(A, N, 2)`."""
    farthest = max(float(np.percentile(np.hypot(points[:, 0], points[:, 1]), 90)), 1.0)
    count = int(np.ceil(window.angle_rad / (field.resolution_m / farthest)))
    turns = np.linspace(-window.angle_rad, window.angle_rad, 2 * count + 1)
    cos, sin = np.cos(guess[2] + turns)[:, None], np.sin(guess[2] + turns)[:, None]
    x, y = points.T
    placed = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + guess[:2]
    cells = np.floor(placed / field.resolution_m).astype(np.int64) - field.corner
    height, width = field.level(0).shape
    side = int(np.ceil(window.distance_m / field.resolution_m))
    return turns, np.clip(cells, side, np.array([width, height]) - 1 - side)


def _scores(
    field: ScoreField, level: int, bases: NDArray[np.int64], branches: NDArray[np.int64]
) -> NDArray[np.float64]:
    scores = field.level(level)
    width = scores.shape[1]
    flat = bases[..., 1] * width + bases[..., 0]
    offset = branches[:, 2] * width + branches[:, 1]
    result = np.empty(len(branches))
    for begin in range(0, len(branches), BATCH * 4):
        part = slice(begin, begin + BATCH * 4)
        result[part] = scores.ravel().take(flat[branches[part, 0]] + offset[part, None]).mean(axis=1)
    return result


def _doubt(
    field: ScoreField,
    level: int,
    branches: NDArray[np.int64],
    turns: NDArray[np.float64],
    window: SearchWindow,
) -> NDArray[np.float64]:
    """Return the smallest doubt among the poses of each branch."""
    low, high = branches[:, 1:], branches[:, 1:] + 2**level - 1
    nearest = np.maximum(np.maximum(low, -high), 0) * field.resolution_m
    squared_m2: NDArray[np.float64] = (nearest**2).sum(axis=1)
    return window.doubt_per_m2 * squared_m2 + window.doubt_per_rad2 * turns[branches[:, 0]] ** 2


def _split(branches: NDArray[np.int64], level: int, side: int) -> NDArray[np.int64]:
    half = 2 ** (level - 1)
    corners = np.array([[0, 0, 0], [0, half, 0], [0, 0, half], [0, half, half]])
    parts: NDArray[np.int64] = (branches[:, None] + corners).reshape(-1, 3)
    return parts[np.asarray((parts[:, 1:] <= side).all(axis=1))]
