"""The grid shows what was seen, wherever that is, can remove sweeps, and does not exceed its limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_robots.workers.mapping.occupancy_grid import CellWindow, GridFull, GrowingGrid

WALL = np.column_stack([np.full(41, 2.03), np.linspace(-1, 1, 41)])


def at(grid: GrowingGrid, x: float, y: float) -> int:
    cells, corner = grid.cells()
    column, row = np.floor((np.array([x, y]) - corner) / grid.resolution_m).astype(int)
    return int(cells[row, column])


def test_beams_free_the_cells_they_pass_and_occupy_the_cell_they_end_in() -> None:
    grid = GrowingGrid(0.05)
    for _ in range(3):
        grid.add((0.01, 0.01), WALL)
    assert at(grid, 1.0, 0.0) < 30
    assert at(grid, 2.03, 0.0) > 80
    assert at(grid, 2.03, 0.99) > 80
    assert at(grid, 0.5, 0.9) == -1


def test_removed_sweep_leaves_no_trace() -> None:
    grid = GrowingGrid(0.05)
    grid.add((0, 0), WALL)
    before, corner = grid.cells()
    grid.add((0.3, 0.1), WALL - 0.5)
    grid.cells()
    grid.remove((0.3, 0.1), WALL - 0.5)
    after, moved_corner = grid.cells()
    row, column = np.round((corner - moved_corner)[::-1] / 0.05).astype(int)
    assert np.array_equal(after[row : row + before.shape[0], column : column + before.shape[1]], before)
    assert (after >= 0).sum() == (before >= 0).sum()


def test_growing_keeps_all_cells_in_place() -> None:
    grid = GrowingGrid(0.05)
    grid.add((0, 0), WALL)
    seen = at(grid, 2.03, 0.5)
    grid.add((-8, -9), WALL - 10)
    assert at(grid, 2.03, 0.5) == seen > 50
    assert at(grid, -7.97, -9.5) > 50


def test_grid_at_its_limit_refuses_and_does_not_change() -> None:
    grid = GrowingGrid(0.05, max_cells=10_000)
    grid.add((0, 0), WALL)
    before = grid.cells()[0].copy()
    with pytest.raises(GridFull, match="more than 10000 cells; choose a coarser resolution"):
        grid.add((0, 0), [[50.0, 0.0]])
    assert np.array_equal(grid.cells()[0], before)
    grid.add((0, 0), WALL)


def test_tiles_that_every_sweep_has_left_are_free_for_others() -> None:
    grid = GrowingGrid(0.05, max_cells=10_000)
    for number in range(5):
        grid.add((100.0 * number, 0), WALL + np.array([100.0 * number, 0]))
        grid.remove((100.0 * number, 0), WALL + np.array([100.0 * number, 0]))
    grid.add((0, 0), WALL)
    assert at(grid, 2.03, 0.0) > 50


def test_places_far_apart_take_memory_for_themselves_only() -> None:
    grid = GrowingGrid(0.05)
    grid.add((0, 0), WALL)
    little = grid.bytes
    grid.add((-90_000, 70_000), WALL + np.array([-90_000, 70_000]))
    assert grid.bytes == little
    rows, columns = grid.known().shape
    assert rows * columns > 1e12


@pytest.mark.slow
def test_square_kilometre_of_corridors_fits_into_300_megabytes() -> None:
    grid = GrowingGrid(0.05)
    ahead = np.linspace(-14.9, 14.9, 50)
    wall = np.concatenate([np.column_stack([ahead, np.full(50, side)]) for side in (-1.5, 1.5)])
    for corridor_m in range(0, 1001, 100):
        for at_m in range(15, 1000, 30):
            grid.add((at_m, corridor_m), wall + np.array([at_m, corridor_m]))
            grid.add((corridor_m, at_m), wall[:, ::-1] + np.array([corridor_m, at_m]))
    rows, columns = grid.known().shape
    assert min(rows, columns) * grid.resolution_m >= 1000
    assert grid.bytes < 300e6


def test_more_beams_in_a_cell_than_16_bits_count_are_kept_exactly() -> None:
    grid = GrowingGrid(0.05)
    same = np.tile([[1.01, 0.01]], (40_000, 1))
    grid.add((0.01, 0.01), same)
    grid.add((0.01, 0.01), same)
    assert at(grid, 1.01, 0.01) == 100
    grid.remove((0.01, 0.01), same)
    grid.remove((0.01, 0.01), same)
    assert (grid.cells()[0] == -1).all()


def test_window_shows_its_part_of_the_map() -> None:
    grid = GrowingGrid(0.05)
    grid.add((0, 0), WALL)
    grid.add((-8, -9), WALL - 10)
    whole, corner_m = grid.cells()
    window = grid.known().around((40, 0), 3000)
    rows, columns = window.shape
    assert 2000 < rows * columns <= 3000
    part, part_corner_m = grid.cells(window)
    column, row = np.round((part_corner_m - corner_m) / 0.05).astype(int)
    assert np.array_equal(part, whole[row : row + rows, column : column + columns])
    bands = [grid.cells(band)[0] for band in grid.known().bands(50)]
    assert np.array_equal(np.concatenate(bands[::-1]), whole)
    assert max(len(band) for band in bands) == 50


def test_window_of_a_long_corridor_is_long() -> None:
    corridor = CellWindow(np.array([0, 0]), np.array([10_000, 20]))
    assert corridor.around((5000, 10), 40_000).shape == (20, 2000)
    assert corridor.around((5000, 10), 200_000) is corridor


def test_overview_shows_every_wall_on_coarser_cells() -> None:
    grid = GrowingGrid(0.05)
    grid.add((0, 0), WALL)
    assert grid.overview(10**6)[2] == 0.05
    cells, corner_m, edge_m = grid.overview(500)
    assert edge_m > 0.05
    assert cells.size <= 500
    for x, y in WALL:
        column, row = np.floor((np.array([x, y]) - corner_m) / edge_m).astype(int)
        assert cells[row, column] > 50


COORDINATES = st.integers(-300, 300).map(lambda hundredth: hundredth / 100 + 0.003)


@given(st.lists(st.tuples(COORDINATES, COORDINATES), max_size=30), COORDINATES, COORDINATES)
@settings(max_examples=50)
def test_every_point_hit_is_occupied_and_nothing_else(
    points: list[tuple[float, float]], x: float, y: float
) -> None:
    grid = GrowingGrid(0.1)
    grid.add((x, y), np.array(points).reshape(-1, 2))
    assert all(at(grid, *point) > 50 for point in points)
    assert (grid.cells()[0] > 50).sum() == len({tuple(np.floor(np.array(point) / 0.1)) for point in points})
