"""Finds redundant key sweeps: those that show the same surfaces as others."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

LIKE_M, LIKE_RAD = 0.4, 0.3  # this distance makes two sweeps as different as this angle does
NEIGHBOURS = 8  # nearest sweeps among which an older one is sought
RECENT_M = 15.0  # of travel: these are still matched against


def redundant(poses: NDArray[np.float64], travelled_m: NDArray[np.float64], count: int) -> list[int]:
    """Choose up to `count` sweeps that are nearest to older ones.

    Of two sweeps that are alike, the older one stays: a map that kept replacing its old sweeps would drift.
    The first sweep and the most recent ones always stay.

    Args:
        poses: Poses of all sweeps, `(N, 3)`, map frame.
        travelled_m: Distance travelled at each sweep, `(N,)`, m.
        count: Maximum number of sweeps to choose.

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
            # Never choose both of a pair that is alike in one round: one of them must stay.
            if len(chosen) < count and left[older[number]]:
                left[number] = False
                chosen.append(number)
    return sorted(chosen)


def _nearest_older(
    places: NDArray[np.float64], numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return each place's nearest older place and its distance; itself and +inf if there is none."""
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
