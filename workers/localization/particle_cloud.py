"""Particles: weighted hypotheses of the robot's pose.

The number needed follows from the number of places they occupy: Fox, "KLD-sampling: adaptive particle
filters" (NIPS 2001).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.planar_pose import compose, wrap_angle

BIN_M, BIN_RAD = 0.2, np.radians(10)
KLD_ERROR = 0.04  # between the particles' distribution and the true one, not exceeded ...
KLD_QUANTILE = 2.33  # ... with a probability of 0.99 (quantile of the normal distribution)
# Radius of a cluster.
CLUSTER_M, CLUSTER_RAD = 0.5, 0.5


@dataclass(frozen=True)
class MotionNoise:
    """Uncertainty of odometry: standard deviations for one step."""

    per_step_m: float = 0.01
    per_m: float = 0.1
    m_per_rad: float = 0.02
    per_step_rad: float = 0.01
    rad_per_m: float = 0.05
    per_rad: float = 0.1


@dataclass(frozen=True)
class Cluster:
    """The cluster with most weight.

    Attributes:
        pose: Their mean (x m, y m, heading rad), map frame.
        weight: Their share of all weight.
        spread_m: Standard deviation of their positions from the mean.
        spread_rad: Standard deviation of their headings from the mean.
    """

    pose: NDArray[np.float64]
    weight: float
    spread_m: float
    spread_rad: float


class ParticleCloud:
    """Poses `(N, 3)`, map frame, and their weights `(N,)`, which sum up to 1."""

    def __init__(self, poses: ArrayLike) -> None:
        self.poses = np.array(poses, float).reshape(-1, 3)
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))

    def __len__(self) -> int:
        return len(self.poses)

    def spread(self, pose: ArrayLike) -> tuple[float, float]:
        """Return the standard deviations of all positions (m) and headings (rad) from a pose."""
        return _spread(_apart(self.poses, np.asarray(pose, float)), self.weights)

    @property
    def effective_count(self) -> float:
        """Return the equivalent number of particles of equal weight."""
        return float(1.0 / (self.weights**2).sum())

    def move(self, step: ArrayLike, noise: MotionNoise, random: np.random.Generator) -> None:
        """Move all particles by a step of odometry (x m, y m, heading rad; robot's frame)."""
        dx, dy, turn = np.abs(np.asarray(step, float))
        way = float(np.hypot(dx, dy))
        across = noise.per_step_m + noise.per_m * way + noise.m_per_rad * turn
        heading = noise.per_step_rad + noise.rad_per_m * way + noise.per_rad * turn
        steps = np.asarray(step, float) + random.normal(size=self.poses.shape) * [across, across, heading]
        self.poses = compose(self.poses, steps)

    def add(self, poses: NDArray[np.float64], weight: float) -> None:
        """Add poses `(M, 3)`, map frame, which share a weight equally; the others keep the rest."""
        self.poses = np.concatenate([self.poses, poses])
        added = np.full(len(poses), weight / len(poses))
        self.weights = np.concatenate([(1.0 - weight) * self.weights, added])

    def weigh(self, log_factors: NDArray[np.float64]) -> None:
        """Multiply the weights by factors, given as logarithms `(N,)`."""
        with np.errstate(divide="ignore"):
            logs = np.log(self.weights) + log_factors
        weights = np.exp(logs - logs.max())
        self.weights = weights / weights.sum()

    def drawn(self, count: int, random: np.random.Generator) -> NDArray[np.float64]:
        """Draw poses `(count, 3)` by weight (low-variance sampling)."""
        places = (np.arange(count) + random.random()) / count
        numbers = np.searchsorted(np.cumsum(self.weights), places).clip(0, len(self) - 1)
        poses: NDArray[np.float64] = self.poses[numbers]
        return poses

    def needed(self, least: int, most: int) -> int:
        """Return how many particles the occupied places need."""
        heavy = self.poses[self.weights > 0.01 / len(self)]
        bins = np.floor(heavy / [BIN_M, BIN_M, BIN_RAD]).astype(np.int64)
        rest = max(1, len(np.unique(bins, axis=0)) - 1)
        share = 2.0 / (9.0 * rest)
        count = rest / (2 * KLD_ERROR) * (1 - share + np.sqrt(share) * KLD_QUANTILE) ** 3
        return int(np.clip(count, least, most))

    def heaviest_cluster(self) -> Cluster:
        """Return the cluster around the best particle, centred on the mean of its vicinity."""
        middle = self.poses[np.argmax(self.weights)]
        for _ in range(3):
            apart = _apart(self.poses, middle)
            inside = (np.hypot(apart[:, 0], apart[:, 1]) < CLUSTER_M) & (np.abs(apart[:, 2]) < CLUSTER_RAD)
            weight = float(self.weights[inside].sum())
            shares = self.weights[inside] / weight
            mean = shares @ apart[inside]
            spread = _spread(apart[inside] - mean, shares)
            middle = middle + mean
        middle[2] = wrap_angle(middle[2])
        return Cluster(middle, weight, *spread)


def _apart(poses: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    apart = poses - pose
    apart[:, 2] = wrap_angle(apart[:, 2])
    return apart


def _spread(apart: NDArray[np.float64], shares: NDArray[np.float64]) -> tuple[float, float]:
    variance = shares @ apart**2
    return float(np.sqrt(variance[0] + variance[1])), float(np.sqrt(variance[2]))
