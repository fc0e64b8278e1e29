"""Which key sweeps show what others show, too."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

LIKE_M, LIKE_RAD = 0.4, 0.3  # sweeps this far apart are as different as those turned by so much
NEIGHBOURS = 2
RECENT_M = 15.0  # of travel: these are still matched against


def redundant(poses: NDArray[np.float64], travelled_m: NDArray[np.float64], count: int) -> list[int]:
    """Choose up to `count` sweeps that are nearest to others, one after the other.

    The first one stays, for it holds the map, and so do the most recent ones. No sweep is chosen in the same
    round as one of its neighbours, so that one of those that are alike always stays.

    Args:
        poses: Of all sweeps, `(N, 3)`, map frame.
        travelled_m: How far the robot had come at each, `(N,)`, m.
        count: How many are to be chosen.

    Returns:
        Their numbers, ascending.
    """
    free = np.flatnonzero(travelled_m < travelled_m[-1] - RECENT_M)
    left = np.ones(len(poses), dtype=bool)
    places = np.column_stack(
        [poses[:, :2] / LIKE_M, np.cos(poses[:, 2]) / LIKE_RAD, np.sin(poses[:, 2]) / LIKE_RAD]
    )
    chosen: list[int] = []
    while len(chosen) < count:
        numbers = np.flatnonzero(left)
        if len(numbers) <= NEIGHBOURS:
            break
        apart, near = cKDTree(places[numbers]).query(places[numbers], k=NEIGHBOURS + 1)
        closeness = np.full(len(poses), np.inf)
        closeness[numbers] = apart[:, 1:].sum(axis=1)
        neighbours = dict(zip(numbers.tolist(), numbers[near[:, 1:]].tolist(), strict=True))
        candidates = [number for number in free.tolist() if number and left[number]]
        if not candidates:
            break
        for number in sorted(candidates, key=lambda number: closeness[number]):
            if len(chosen) < count and left[neighbours[number]].all():
                left[number] = False
                chosen.append(number)
    return sorted(chosen)
