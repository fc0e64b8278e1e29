"""Finds redundant key sweeps: those that show the same as others."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

LIKE_M, LIKE_RAD = 0.4, 0.3  # sweeps this far apart are as different as those turned by so much
NEIGHBOURS = 8  # among which an older one is looked for
RECENT_M = 15.0  # of travel: these are still matched against


def redundant(poses: NDArray[np.float64], travelled_m: NDArray[np.float64], count: int) -> list[int]:
    """Choose up to `count` sweeps that are nearest to older ones.

    The older one of two that are alike stays: a map whose old sweeps went, generation after generation, would
    drift. The first one stays in any case, and so do the most recent ones.

    Args:
        poses: Of all sweeps, `(N, 3)`, map frame.
        travelled_m: How far the robot had come at each, `(N,)`, m.
        count: How many are to be chosen.

    Returns:
        Their numbers, ascending.
    """
    places = np.column_stack(
        [poses[:, :2] / LIKE_M, np.cos(poses[:, 2]) / LIKE_RAD, np.sin(poses[:, 2]) / LIKE_RAD]
    )
    left = np.ones(len(poses), dtype=bool)
    old = travelled_m < travelled_m[-1] - RECENT_M
    old[0] = False
    chosen: list[int] = []
    while len(chosen) < count and (left & old).any():
        older, apart = _nearest_older(places, np.flatnonzero(left))
        for number in sorted(np.flatnonzero(left & old).tolist(), key=lambda number: apart[number]):
            # Not in one round with the one it is like, so that one of them stays.
            if len(chosen) < count and left[older[number]]:
                left[number] = False
                chosen.append(number)
    return sorted(chosen)


def _nearest_older(
    places: NDArray[np.float64], numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return for each place the older one nearest to it, and how far that is; without one itself, +inf."""
    older, apart = np.arange(len(places)), np.full(len(places), np.inf)
    most = min(NEIGHBOURS + 1, len(numbers))
    found_m, found_at = cKDTree(places[numbers]).query(places[numbers], k=range(1, most + 1))
    distances, near = np.asarray(found_m), np.asarray(found_at)
    distances[near >= np.arange(len(numbers))[:, None]] = np.inf
    best = distances.argmin(axis=1)
    rows = np.arange(len(numbers))
    found = np.isfinite(distances[rows, best])
    older[numbers[found]] = numbers[near[rows, best][found]]
    apart[numbers] = distances[rows, best]
    return older, apart
