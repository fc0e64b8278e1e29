"""Walls count as searched only where the camera has seen them well."""

import math

import numpy as np
import pytest

from robbie_robots.workers.navigation.path_planner import PathField
from robbie_robots.workers.rescue.search_views import search_views
from robbie_robots.workers.rescue.searched_walls import (
    NOTHING,
    SEARCHED,
    UNSEARCHED,
    CameraView,
    WallFronts,
    WallMemory,
)
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells, drawn_grid

ROOM = """
################
#..............#
#..............#
#..............#
#......##......#
#..............#
#..............#
#..............#
################
"""
CORNER = (0.0, 0.0)
HALF_WIDTH_RAD = 0.7


@pytest.fixture
def fronts() -> WallFronts:
    return WallFronts(drawn_cells(ROOM), RESOLUTION_M, CORNER)


def at(fronts: WallFronts, x_m: float, y_m: float) -> int:
    """Number of the front cell around a point."""
    distance = np.hypot(*(fronts.middles_m - (x_m, y_m)).T)
    assert distance.min() < RESOLUTION_M
    return int(distance.argmin())


def seen(fronts: WallFronts, *eye: float) -> np.ndarray:
    return fronts.seen_from(eye, HALF_WIDTH_RAD, CameraView())


def test_fronts_are_free_and_face_into_the_room(fronts: WallFronts) -> None:
    left, top = at(fronts, 0.275, 1.0), at(fronts, 2.0, 1.975)
    assert fronts.normals[left] == pytest.approx([1.0, 0.0], abs=0.05)
    assert fronts.normals[top] == pytest.approx([0.0, -1.0], abs=0.05)


def test_wall_ahead_is_seen_and_walls_behind_and_beside_are_not(fronts: WallFronts) -> None:
    visible = seen(fronts, 1.5, 0.6, math.pi)
    assert visible[at(fronts, 0.275, 0.6)]
    assert not visible[at(fronts, 3.725, 0.6)]  # behind
    assert not visible[at(fronts, 1.5, 0.275)]  # too far aside in the image


def test_wall_seen_at_a_slant_does_not_count(fronts: WallFronts) -> None:
    assert not seen(fronts, 0.4, 1.8, -math.pi / 2 - 0.1)[at(fronts, 0.275, 0.5)]


def test_wall_behind_an_obstacle_is_not_seen(fronts: WallFronts) -> None:
    assert not seen(fronts, 2.0, 0.4, math.pi / 2)[at(fronts, 2.0, 1.975)]
    assert seen(fronts, 1.0, 0.4, math.pi / 2)[at(fronts, 1.0, 1.975)]


def test_wall_too_far_away_is_not_seen(fronts: WallFronts) -> None:
    assert not seen(fronts, 3.4, 0.6, math.pi)[at(fronts, 0.275, 0.6)]


def test_searched_walls_are_kept_when_the_map_grows_and_after_a_restart(fronts: WallFronts) -> None:
    memory = WallMemory()
    memory.look(fronts, (1.5, 0.6, math.pi), HALF_WIDTH_RAD)
    grid = memory.grid(fronts)
    assert {NOTHING, UNSEARCHED, SEARCHED} == set(np.unique(grid).tolist())
    grown = WallFronts(np.pad(drawn_cells(ROOM), 10, constant_values=-1), RESOLUTION_M, (-0.5, -0.5))
    again = WallMemory()
    again.restore(memory.state())
    assert (again.grid(grown)[10:-10, 10:-10] == grid).all()


def test_views_are_drivable_places_that_see_each_unsearched_wall(fronts: WallFronts) -> None:
    grid = drawn_grid(ROOM)
    ways = PathField(grid, grid.cell((1.0, 0.6)))
    todo = fronts.middles_m[:, 0] > 3.7  # the wall to the right
    (view, *others) = search_views(grid, ways.cost_m, fronts, todo, 0.3)
    assert others == [] or len(others) == 1  # a long wall is looked at in parts
    assert view.look_at_xy_m[0] > 3.7
    place = grid.middles_m(view.cell)
    assert grid.drivable[view.cell]
    heading = math.atan2(*(view.look_at_xy_m - place)[::-1])
    assert seen(fronts, *place, heading)[at(fronts, *view.look_at_xy_m)]


def test_short_pieces_of_wall_are_ignored(fronts: WallFronts) -> None:
    grid = drawn_grid(ROOM)
    ways = PathField(grid, grid.cell((1.0, 0.6)))
    todo = (fronts.middles_m[:, 0] > 3.7) & (np.abs(fronts.middles_m[:, 1] - 1.0) < 0.1)
    assert search_views(grid, ways.cost_m, fronts, todo, 0.3) == []
