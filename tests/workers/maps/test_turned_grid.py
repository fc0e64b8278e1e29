"""Grids with a turned origin keep their walls where they are."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.workers.maps.turned_grid import axis_aligned, turned_shape


def cell_at(grid: tuple[NDArray[np.int8], float, NDArray[np.float64]], xy_m: NDArray[np.float64]) -> int:
    """Return the value of the cell at a point."""
    cells, resolution_m, corner_xy_m = grid
    column, row = np.floor((xy_m - corner_xy_m) / resolution_m).astype(int)
    return int(cells[row, column])


@pytest.mark.parametrize("degrees", [0, 30, 45, 90, 135, 180, -90, 270.0])
def test_known_wall_lies_where_its_turned_grid_has_it(degrees: float) -> None:
    yaw_rad = math.radians(degrees)
    cells = np.zeros((40, 60), np.int8)
    cells[:, 50] = 100  # a wall at x = 5.05 m of the grid
    grid = axis_aligned(cells, 0.1, (3.0, -2.0), yaw_rad)
    start = np.array([3.0, -2.0])
    along, across = (
        np.array([math.cos(yaw_rad), math.sin(yaw_rad)]),
        np.array([-math.sin(yaw_rad), math.cos(yaw_rad)]),
    )
    for y_m in (0.55, 2.05, 3.45):
        for x_m, value in ((5.05, 100), (4.75, 0), (5.35, 0), (0.55, 0)):
            assert cell_at(grid, start + x_m * along + y_m * across) == value


@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(-7, 7),
    st.integers(0, 2**32 - 1),
)
def test_no_obstacle_is_lost_by_a_turn(height: int, width: int, yaw_rad: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    cells = random.choice(
        np.array([-1, 0, 40, 60, 100], np.int8), (height, width), p=[0.3, 0.3, 0.3, 0.05, 0.05]
    )
    turned, _, corner = axis_aligned(cells, 1.0, (0.0, 0.0), yaw_rad)
    assert turned.shape == turned_shape(cells.shape, yaw_rad)
    occupied = np.argwhere(cells >= 50)[:, ::-1] + 0.5
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    for x, y in occupied @ np.array([[c, s], [-s, c]]) - corner:
        assert turned[math.floor(y), math.floor(x)] >= 50
    assert (turned >= 50).sum() <= 4 * len(occupied)


def test_quarter_turn_moves_cells_exactly() -> None:
    cells = np.arange(12, dtype=np.int8).reshape(3, 4)
    turned, _, corner = axis_aligned(cells, 0.5, (0, 0), math.pi / 2)
    assert turned.tolist() == np.rot90(cells[::-1])[::-1].tolist()
    assert corner == pytest.approx([-1.5, 0])


def test_thin_wall_stays_closed() -> None:
    cells = np.zeros((50, 50), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for degrees in range(0, 90, 7):
        turned, _, _ = axis_aligned(cells, 0.1, (0, 0), math.radians(degrees))
        inside, _ = ndimage.label(turned < 50)
        outside = {int(label) for label in np.unique(inside[turned < 0])}
        middle = int(inside[turned.shape[0] // 2, turned.shape[1] // 2])
        assert middle not in outside
