"""Another robot's map is found in this robot's map, or refused."""

import re

import numpy as np
import pytest
from numpy.typing import ArrayLike

from robbie_robots.workers.maps.map_alignment import GridMap, align, merged, without_robot
from robbie_robots.workers.planar_pose import compose, relative, wrap_angle
from tests.workers._support.known_room import draw

RED, BLUE = np.array([1.0, 1.0, 0.3]), np.array([6.0, 4.0, 2.2])
TRUE = relative(RED, BLUE)
SQUARE = np.array([[0, 0, 6, 0], [6, 0, 6, 6], [6, 6, 0, 6], [0, 6, 0, 0]], float)


def off(pose: ArrayLike) -> tuple[float, float]:
    """Distance (m) and angle (rad) of a pose from the true one."""
    x, y, turn = relative(TRUE, pose).tolist()
    return float(np.hypot(x, y)), abs(turn)


def test_map_is_found_from_any_start_where_the_robots_saw_common_walls() -> None:
    found = align(draw(RED, to_x_m=7.0), draw(BLUE, from_x_m=1.0, resolution_m=0.04))
    assert found.is_sure, found.doubt
    away_m, turned_rad = off(found.pose)
    assert away_m < 0.06
    assert turned_rad < 0.02


def test_known_start_is_refined() -> None:
    found = align(draw(RED, to_x_m=6.0), draw(BLUE, from_x_m=2.0), compose(TRUE, [0.3, -0.2, 0.1]))
    assert found.is_sure, found.doubt
    assert off(found.pose)[0] < 0.04


@pytest.mark.parametrize(
    ("own", "other", "doubt"),
    [
        (draw(RED, segments=SQUARE), draw(BLUE, segments=SQUARE), "another pose fits almost as well"),
        (draw(RED), draw(BLUE, segments=SQUARE), "of the walls lie on walls"),
        (draw(RED), draw(BLUE, to_x_m=0.2, from_x_m=0.1), "a map has no walls|m of wall are on both maps"),
        (draw(RED), GridMap(np.full((5, 5), -1, np.int8), 0.05, (0.0, 0.0)), "a map has no walls"),
    ],
    ids=["symmetric room", "different room", "hardly any wall", "empty map"],
)
def test_unsure_match_is_refused_with_a_reason(own: GridMap, other: GridMap, doubt: str) -> None:
    found = align(own, other)
    assert not found.is_sure
    assert re.search(doubt, found.doubt)


def test_known_start_stays_as_it_is_where_the_maps_do_not_confirm_a_better_one() -> None:
    found = align(draw(RED), draw(BLUE, segments=SQUARE), TRUE)
    assert not found.is_sure
    assert off(found.pose) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert wrap_angle(found.pose[2] - TRUE[2]) == pytest.approx(0.0, abs=1e-9)


def test_merged_map_knows_what_either_robot_saw_and_keeps_its_own_cells() -> None:
    own, other = draw(RED, to_x_m=4.0), draw(BLUE, from_x_m=3.0)
    team, whole = merged(own, [(other, TRUE)]), draw(RED)
    rows, columns = np.nonzero(whole.cells >= 0)
    places = whole.middles(whole.cells >= 0)
    assert (team.occupancy(places) >= 0).mean() > 0.99
    wrong = team.occupancy(places) != whole.cells[rows, columns]
    assert wrong.mean() < 0.03, "only edges of walls differ"
    is_own = own.cells >= 0
    assert np.array_equal(team.occupancy(own.middles(is_own)), own.cells[is_own])
    assert (merged(own, []).cells == own.cells).all()


def test_wall_beside_a_robots_trail_is_no_wall_if_the_robots_own_map_shows_free_ground_there() -> None:
    own, other = (GridMap(np.zeros((40, 80), np.int8), 0.05, (0.0, 0.0)) for _ in range(2))
    pose, trail = np.array([1.0, 0.0, 0.0]), np.array([[2.0, 1.0]])
    ghost, beyond, wall = (20, 47), (20, 53), (13, 40)  # 0.35, 0.65 and 0.35 m from the trail
    for cell in (ghost, beyond, wall):
        own.cells[cell] = 100
    other.cells[wall[0], wall[1] - 20] = 100

    def walls(seen: GridMap | None, radius_m: float) -> set[tuple[int, int]]:
        cells = without_robot(own, trail, radius_m, seen, pose).cells
        return {(row, column) for row, column in np.argwhere(cells == 100).tolist()}

    assert walls(other, 0.25) == {beyond, wall}
    assert walls(None, 0.25) == {ghost, beyond, wall}
    assert walls(None, 0.4) == {beyond}
