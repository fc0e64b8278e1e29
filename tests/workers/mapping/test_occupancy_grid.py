"""The grid shows what was seen, can remove sweeps, and does not exceed its limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workers.mapping.occupancy_grid import GridFull, OccupancyGrid

WALL = np.column_stack([np.full(41, 2.03), np.linspace(-1, 1, 41)])


def at(grid: OccupancyGrid, x: float, y: float) -> int:
    cells, corner = grid.cells()
    column, row = np.floor((np.array([x, y]) - corner) / grid.resolution_m).astype(int)
    return int(cells[row, column])


def test_beams_free_the_cells_they_pass_and_occupy_the_cell_they_end_in() -> None:
    grid = OccupancyGrid(0.05)
    for _ in range(3):
        grid.add((0.01, 0.01), WALL)
    assert at(grid, 1.0, 0.0) < 30
    assert at(grid, 2.03, 0.0) > 80
    assert at(grid, 2.03, 0.99) > 80
    assert at(grid, 0.5, 0.9) == -1


def test_removed_sweep_leaves_no_trace() -> None:
    grid = OccupancyGrid(0.05)
    grid.add((0, 0), WALL)
    before, corner = grid.cells()
    grid.add((0.3, 0.1), WALL - 0.5)
    grid.remove((0.3, 0.1), WALL - 0.5)
    after, moved_corner = grid.cells()
    row, column = np.round((corner - moved_corner)[::-1] / 0.05).astype(int)
    assert np.array_equal(after[row : row + before.shape[0], column : column + before.shape[1]], before)
    assert (after >= 0).sum() == (before >= 0).sum()


def test_growing_keeps_all_cells_in_place() -> None:
    grid = OccupancyGrid(0.05)
    grid.add((0, 0), WALL)
    seen = at(grid, 2.03, 0.5)
    grid.add((-8, -9), WALL - 10)
    assert at(grid, 2.03, 0.5) == seen > 50
    assert at(grid, -7.97, -9.5) > 50


def test_grid_at_its_limit_refuses_and_does_not_change() -> None:
    grid = OccupancyGrid(0.05, max_cells=10_000)
    grid.add((0, 0), WALL)
    before = grid.cells()[0].copy()
    with pytest.raises(GridFull, match="more than 10000 cells; choose a coarser resolution"):
        grid.add((0, 0), [[50.0, 0.0]])
    assert np.array_equal(grid.cells()[0], before)
    grid.add((0, 0), WALL)


COORDINATES = st.integers(-300, 300).map(lambda hundredth: hundredth / 100 + 0.003)


@given(st.lists(st.tuples(COORDINATES, COORDINATES), max_size=30), COORDINATES, COORDINATES)
@settings(max_examples=50)
def test_every_point_hit_is_occupied_and_nothing_else(
    points: list[tuple[float, float]], x: float, y: float
) -> None:
    grid = OccupancyGrid(0.1)
    grid.add((x, y), np.array(points).reshape(-1, 2))
    assert all(at(grid, *point) > 50 for point in points)
    assert (grid.cells()[0] > 50).sum() == len({tuple(np.floor(np.array(point) / 0.1)) for point in points})
