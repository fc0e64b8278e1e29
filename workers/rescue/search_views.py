"""Next best views: where to go so that the camera sees walls it has not seen yet.

The choice weighs the path cost against the length of wall in view, as the choice of a frontier does. See
Gonzalez-Banos and Latombe, "Navigation strategies for exploring indoor environments" (IJRR 2002).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.workers.maps.navigation_grid import Cell, NavigationGrid
from robbie_robots.workers.rescue.searched_walls import ALL_EIGHT, WallFronts

# Distance of a view from the wall: the best one, and the limits.
BEST_M, NEAREST_M, FARTHEST_M = 1.1, 0.6, 1.9
SLANT_RAD = 0.8
PIECE_CELLS = 24
"""A longer piece of wall is split into several views."""


@dataclass(frozen=True)
class SearchView:
    """A place from which to look at an unsearched wall.

    Attributes:
        cell: (row, column) of the place.
        look_at_xy_m: `(2,)`, m, map frame: the middle of the piece of wall.
        length_m: length of the piece.
        cost_m: path cost to the place.
    """

    cell: Cell
    look_at_xy_m: NDArray[np.float64]
    length_m: float
    cost_m: float


def search_views(
    grid: NavigationGrid,
    cost_m: NDArray[np.float64],
    fronts: WallFronts,
    todo: NDArray[np.bool_],
    min_length_m: float,
) -> list[SearchView]:
    """Return a view for each piece of unsearched wall that can be seen from somewhere.

    Args:
        grid: Where the robot may be.
        cost_m: Path cost to each cell of `grid`, +inf where no path leads.
        fronts: The map's front cells.
        todo: Which of the front cells have not been searched `(N,)`.
        min_length_m: Shorter pieces are ignored.
    """
    marked = np.zeros(fronts.shape, dtype=bool)
    marked[tuple(fronts.cells[todo].T)] = True
    labels, _ = ndimage.label(marked, ALL_EIGHT)
    label_of_front = labels[tuple(fronts.cells.T)]
    reached = np.argwhere(np.isfinite(cost_m))
    if len(reached) == 0:
        return []
    places = grid.middles_m(reached)
    costs = cost_m[tuple(reached.T)]
    views = []
    for label in np.unique(label_of_front[todo]):
        piece = np.flatnonzero(label_of_front == label)
        for part in _parts(piece, fronts):
            length_m = len(part) * grid.resolution_m
            if length_m >= min_length_m:
                view = _view(fronts, part, reached, places, costs, length_m)
                views += [view] if view is not None else []
    return views


def _parts(piece: NDArray[np.intp], fronts: WallFronts) -> list[NDArray[np.intp]]:
    """Cut a piece of wall along its longer side."""
    count = math.ceil(len(piece) / PIECE_CELLS)
    middles = fronts.middles_m[piece]
    axis = int(np.argmax(np.ptp(middles, axis=0)))
    return [part for part in np.array_split(piece[np.argsort(middles[:, axis])], count) if len(part)]


def _view(
    fronts: WallFronts,
    part: NDArray[np.intp],
    reached: NDArray[np.intp],
    places: NDArray[np.float64],
    costs: NDArray[np.float64],
    length_m: float,
) -> SearchView | None:
    """Find the cheapest place from which the middle of a part is seen well."""
    middles = fronts.middles_m[part]
    middle = part[np.argmin(((middles - middles.mean(axis=0)) ** 2).sum(axis=1))]
    target, normal = fronts.middles_m[middle], fronts.normals[middle]
    offset = places - target
    distance = np.hypot(*offset.T)
    good = (distance >= NEAREST_M) & (distance <= FARTHEST_M)
    good &= (offset * normal).sum(axis=1) >= distance * math.cos(SLANT_RAD)
    chosen = np.flatnonzero(good)
    if len(chosen) == 0:
        return None
    order = chosen[np.argsort(costs[chosen] + np.abs(distance[chosen] - BEST_M))]
    for index in order[:: max(1, len(order) // 12)][:12]:
        if fronts.is_in_sight(places[index], target[None])[0]:
            row, column = reached[index]
            return SearchView((int(row), int(column)), target, length_m, float(costs[index]))
    return None
