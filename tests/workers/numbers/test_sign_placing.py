"""Posts are found in scans along a ray, and on maps; walls and wide things are none."""

import math

import numpy as np
import pytest

from robbie_robots.workers.numbers.sign_placing import SignView, distances_m, posts_on

RESOLUTION_M = 0.05
POST = [(3.0, 0.02), (2.97, -0.03), (2.97, 0.04)]
WALL = [(5.0, y / 10) for y in range(-20, 20)]


def view(points: list[tuple[float, float]]) -> SignView:
    return SignView((0.1, 0.0, 0.0), 0.5, np.array(points, float))


def test_post_before_a_wall_is_found_along_the_ray() -> None:
    post = view([*POST, *WALL]).post_along(0.01, 1.0, 6.0)
    assert post == pytest.approx([2.98, 0.01], abs=0.02)


def test_wall_is_no_post() -> None:
    assert view(WALL).post_along(0.0, 1.0, 6.0) is None


def test_post_beside_the_ray_or_outside_the_distances_is_not_taken() -> None:
    assert view(POST).post_along(0.2, 1.0, 6.0) is None
    assert view(POST).post_along(0.0, 3.5, 6.0) is None
    assert view(POST).post_along(math.pi, 1.0, 6.0) is None


def test_place_is_shown_if_it_is_near_and_nothing_is_before_it() -> None:
    assert view([*POST, *WALL]).shows((3.0, 0.0), 1.6, 3.2)
    assert not view([*POST, *WALL]).shows((3.0, 0.0), 1.6, 2.8)
    assert not view([*POST, *WALL]).shows((3.0, 0.0), 3.0, 6.0)  # so near that a board may be cut off
    assert not view([*POST, *WALL]).shows((4.5, 0.0), 1.6, 6.0)  # behind the post
    assert not view([*POST, *WALL]).shows((1.0, 2.0), 1.6, 6.0)  # beside the picture


def test_board_is_placed_nowhere_if_two_posts_may_carry_it() -> None:
    behind = [(x + 1.5, y) for x, y in POST]
    assert view([*POST, *behind]).post_along(0.0, 1.0, 6.0) is None
    assert view([*POST, *behind]).post_along(0.0, 1.0, 4.0) == pytest.approx([2.98, 0.01], abs=0.02)


def test_board_is_placed_nowhere_if_the_map_shows_another_post_that_the_beams_have_missed() -> None:
    behind, beside = np.array([[4.5, 0.0]]), np.array([[4.5, 1.0]])
    assert view(POST).post_along(0.0, 1.0, 6.0, behind) is None
    assert view(POST).post_along(0.0, 1.0, 4.0, behind) is not None
    assert view(POST).post_along(0.0, 1.0, 6.0, beside) is not None
    assert view(POST).post_along(0.0, 1.0, 6.0, np.array([[2.98, 0.01]])) is not None


def test_height_in_the_image_bounds_the_distance() -> None:
    near_m, far_m = distances_m(0.45 * 550 / 3.0, 550.0)
    assert near_m < 3.0 < far_m


def map_with(*boxes: tuple[int, int, int, int]) -> np.ndarray:
    cells = np.zeros((120, 120), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for top, bottom, left, right in boxes:
        cells[top:bottom, left:right] = 100
    return cells


def test_small_thing_on_the_map_is_a_post() -> None:
    [post] = posts_on(map_with((40, 42, 60, 63)), RESOLUTION_M, (-1.0, -2.0))
    assert post == pytest.approx([61.5 * 0.05 - 1.0, 41 * 0.05 - 2.0])


def test_wide_things_and_pieces_of_walls_are_no_posts() -> None:
    cells = map_with((40, 50, 20, 32), (1, 3, 20, 22))
    # A lone cell in a corner of what is known may be a piece of anything.
    cells[66:], cells[:, 66:] = -1, -1
    cells[65, 65] = 100
    assert len(posts_on(cells, RESOLUTION_M, (0.0, 0.0))) == 0
