"""A room to map: walls as segments, a laser without a robot, and a drive with drifting odometry."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.planar_pose import compose, relative

CORNERS: dict[str, list[tuple[float, float]]] = {
    "walls": [(0, 0), (8, 0), (8, 6), (0, 6), (0, 0)],
    "pillar": [(3.5, 2.5), (4.5, 2.5), (4.5, 3.2), (3.5, 3.2), (3.5, 2.5)],
    "shelf": [(0, 4.2), (1.1, 4.2), (1.1, 4.8), (0, 4.8)],
    "door": [(6.2, 6), (6.2, 5.3), (6.9, 5.3), (6.9, 6)],
    "screen": [(5.5, 0), (5.9, 1.1)],
}
SEGMENTS: NDArray[np.float64] = np.array(
    [[*a, *b] for line in CORNERS.values() for a, b in pairwise(line)], np.float64
)
ANGLE_MIN_RAD, BEAMS = -np.pi / 2, 180
INCREMENT_RAD = np.pi / BEAMS
RANGE_MAX_M = 12.0


def measure(
    pose: NDArray[np.float64], random: np.random.Generator, noise_m: float = 0.01
) -> NDArray[np.float32]:
    """A sweep `(180,)`, m, taken at a pose (x, y, heading) in the room."""
    bearings = ANGLE_MIN_RAD + INCREMENT_RAD * np.arange(BEAMS)
    noisy = distances_m(pose, bearings, SEGMENTS) + noise_m * random.standard_normal(BEAMS)
    return noisy.astype(np.float32)


def distances_m(
    pose: NDArray[np.float64], bearings: NDArray[np.floating[Any]], segments: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far the walls are from a pose in each direction, `(N,)`; infinite where there is none.

    Args:
        pose: x and y in m, heading in rad.
        bearings: `(N,)`, rad, from the heading.
        segments: `(M, 4)`, m: the ends of the walls.
    """
    ray = np.column_stack([np.cos(bearings + pose[2]), np.sin(bearings + pose[2])])[:, None]
    begin, along = segments[:, :2] - pose[:2], segments[:, 2:] - segments[:, :2]
    across = ray[..., 0] * along[:, 1] - ray[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) / across
        share = (begin[:, 0] * ray[..., 1] - begin[:, 1] * ray[..., 0]) / across
    hit = (distance > 0) & (share >= 0) & (share <= 1)
    nearest: NDArray[np.float64] = np.where(hit, distance, np.inf).min(axis=1, initial=np.inf)
    return nearest


@dataclass(frozen=True)
class Drive:
    """A drive round the pillar: odometry at 50 Hz, a sweep every 0.1 s between two odometry stamps.

    Attributes:
        true: `(M, 4)`: stamp, x, y, heading, in the room.
        odometry: `(M, 4)`, with 4 % too much turning and some noise, beginning at the true pose.
    """

    true: NDArray[np.float64]
    odometry: NDArray[np.float64]

    @staticmethod
    def around_the_pillar(seconds: float, seed: int = 1) -> "Drive":
        random = np.random.default_rng(seed)
        stamps = 100 + np.arange(0, seconds, 0.02)
        angle = 0.35 * (stamps - stamps[0])
        x, y = 4 + 1.9 * np.cos(angle), 2.9 + 1.4 * np.sin(angle)
        heading = np.unwrap(np.arctan2(1.4 * np.cos(angle), -1.9 * np.sin(angle)))
        true = np.column_stack([x, y, heading])
        steps = relative(true[:-1], true[1:])
        measured = steps * [1.02, 1, 1.04] + random.standard_normal(steps.shape) * [2e-4, 2e-4, 2e-4]
        odometry = [true[0]]
        for step in measured:
            odometry.append(compose(odometry[-1], step))
        return Drive(np.column_stack([stamps, true]), np.column_stack([stamps, np.array(odometry)]))

    def true_at(self, stamp_s: float) -> NDArray[np.float64]:
        return np.array([np.interp(stamp_s, self.true[:, 0], self.true[:, column]) for column in (1, 2, 3)])
