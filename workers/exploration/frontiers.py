"""Frontiers: the borders between free and unknown space.

After Yamauchi, "A frontier-based approach for autonomous exploration" (CIRA 1997).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.workers.maps.navigation_grid import NavigationGrid

ALL_EIGHT = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True)
class Frontier:
    """A connected piece of the border between free and unknown.

    Attributes:
        cells: `(N, 2)`, (row, column).
        middle_xy_m: `(2,)`, m, map frame: the cell nearest to the mean of all cells.
        length_m: Number of cells times their edge.
    """

    cells: NDArray[np.int64]
    middle_xy_m: NDArray[np.float64]
    length_m: float


def find_frontiers(grid: NavigationGrid, min_length_m: float) -> list[Frontier]:
    """Find the frontiers of useful length, the longest first.

    Unknown spots narrower than three cells do not make a frontier: they are the gaps between far beams.

    Args:
        grid: What is free and what is unknown.
        min_length_m: Shorter ones are skipped; use about the robot's width.
    """
    # Everything outside the grid is unknown; the padding keeps the opening from eroding the edge.
    unknown = ndimage.binary_opening(np.pad(grid.unknown, 1, constant_values=True), ALL_EIGHT)[1:-1, 1:-1]
    border = grid.free & ndimage.binary_dilation(unknown)
    labels, count = ndimage.label(border, ALL_EIGHT)
    min_cells = min_length_m / grid.resolution_m
    found = []
    for number, box in enumerate(ndimage.find_objects(labels, count), start=1):
        cells = np.argwhere(labels[box] == number) + np.array([box[0].start, box[1].start])
        if len(cells) >= min_cells:
            found.append(_frontier(grid, cells))
    return sorted(found, key=lambda frontier: -frontier.length_m)


def _frontier(grid: NavigationGrid, cells: NDArray[np.int64]) -> Frontier:
    middle = cells[np.argmin(((cells - cells.mean(axis=0)) ** 2).sum(axis=1))]
    return Frontier(cells, grid.middles_m(middle), len(cells) * grid.resolution_m)
