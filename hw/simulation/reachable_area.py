"""The area of an arena that a robot can reach, as a grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.hw.simulation.arena import Arena

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ReachableArea:
    """The area connected with the robot's start.

    The middle of cell (row, column) is at x = (column + 0.5) * resolution_m, y = (row + 0.5) * resolution_m
    of the arena frame.

    Attributes:
        resolution_m: edge of a cell.
        drivable: (rows, columns), cells that the robot's centre can reach.
        free: (rows, columns), cells that a point can reach, and so a robot can see; accurate to half a cell.
    """

    resolution_m: float
    drivable: Mask
    free: Mask

    @property
    def drivable_m2(self) -> float:
        """Return the area that the robot's centre can reach."""
        return float(self.drivable.sum()) * self.resolution_m**2

    @property
    def free_m2(self) -> float:
        """Return the area that a point could reach."""
        return float(self.free.sum()) * self.resolution_m**2


def reachable_area(arena: Arena, body_radius_m: float = 0.20, resolution_m: float = 0.05) -> ReachableArea:
    """Return the area that a round robot can reach from the arena's start.

    Args:
        arena: the world, without temporary obstacles.
        body_radius_m: the robot's radius.
        resolution_m: edge of the grid's cells.
    """
    rows, columns = round(arena.height_m / resolution_m), round(arena.width_m / resolution_m)
    x, y = (np.arange(columns) + 0.5) * resolution_m, (np.arange(rows) + 0.5) * resolution_m
    # Row by row, because all cells and walls at once would need much memory.
    clearance = np.stack([arena.clearance_m(np.stack([x, np.full(columns, at)], axis=1)) for at in y])
    start = int(arena.start.y_m / resolution_m), int(arena.start.x_m / resolution_m)
    # No surface crosses a cell that is farther from it than half its diagonal; the cells next to those are
    # the last ones before the surface.
    free = ndimage.binary_dilation(connected(clearance > 0.71 * resolution_m, start))
    return ReachableArea(resolution_m, connected(free & (clearance >= body_radius_m), start), free)


def connected(passable: Mask, start: tuple[int, int]) -> Mask:
    """Return the cells that are connected with a cell by common edges."""
    regions, _ = ndimage.label(passable)
    return passable & (regions == regions[start]) if passable[start] else np.zeros_like(passable)
