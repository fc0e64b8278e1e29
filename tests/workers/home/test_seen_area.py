"""What the robot has looked at, and where it looks next."""

import math

import numpy as np
import pytest

from robbie_robots.workers.home.seen_area import SeenArea

RESOLUTION_M = 0.05


def area(width_m: float = 12.0, fewest_cells: int = 8) -> SeenArea:
    """Return an area with a corridor along x, 2 m wide, from (0, 0)."""
    cells = np.zeros((round(2 / RESOLUTION_M), round(width_m / RESOLUTION_M)), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    found = SeenArea(fewest_cells=fewest_cells)
    found.see_map(cells, RESOLUTION_M, (0.0, 0.0))
    return found


def test_nearest_place_out_of_sight_is_next_until_all_is_seen() -> None:
    corridor, robot, places = area(), (1.0, 1.0), []
    corridor.look_from(robot)
    while (place := corridor.next_place(robot)) is not None:
        places.append(place)
        robot = place
        corridor.look_from(robot)
        corridor.leave_out(robot)
    assert places[0][0] == pytest.approx(4.5, abs=0.4)
    assert 2 <= len(places) <= 6
    assert corridor.is_seen((11.0, 1.0))


def test_wall_hides_what_is_behind_it() -> None:
    cells = np.zeros((80, 80), np.int8)
    cells[:, 40] = 100
    room = SeenArea()
    room.see_map(cells, RESOLUTION_M, (0.0, 0.0))
    room.look_from((1.0, 2.0))
    assert room.is_seen((1.7, 2.0))
    assert not room.is_seen((2.4, 2.0))
    assert room.next_place((1.0, 2.0)) is None  # nobody gets there


def test_what_was_seen_is_kept_while_the_map_grows() -> None:
    corridor = area(6.0)
    corridor.look_from((1.0, 1.0))
    wider = np.zeros((60, 400), np.int8)
    corridor.see_map(wider, RESOLUTION_M, (-8.0, -0.5))
    assert corridor.is_seen((1.5, 1.0))
    assert not corridor.is_seen((-6.0, 1.0))


def test_course_decides_between_places_that_are_equally_near() -> None:
    corridor = area(13.0)
    corridor.look_from((6.5, 1.0))
    for course, sign in ((0.0, 1), (math.pi, -1)):
        place = corridor.next_place((6.5, 1.0), course)
        assert place is not None
        assert (place[0] - 6.5) * sign > 0


def test_place_outside_of_the_map_changes_nothing() -> None:
    corridor = area()
    corridor.look_from((-30.0, 1.0))
    assert not corridor.is_seen((-30.0, 1.0))
    assert corridor.next_place((1.0, 1.0)) is not None
