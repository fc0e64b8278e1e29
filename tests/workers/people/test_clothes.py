"""Clothes are compared by their colours, where a person is seen well."""

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaPerson, Colour
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.hw.simulation.people import WalkingPeople
from robbie_robots.workers.people.clothes import ClothesView, blended, clothes_in, similarity

GEOMETRY = CameraGeometry(400, 320, 1.2, (0.0, 0.0, 1.1))
# The optical frame of a camera that looks along x: z ahead, x to the right, y down.
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
RED, BLUE, GREEN = (190, 40, 40), (50, 60, 110), (40, 120, 60)


def seen(*persons: tuple[float, float, Colour, Colour], seed: int = 0) -> list[NDArray[np.float64] | None]:
    """Return the clothes of persons (x, y, shirt, trousers) who stand in front of a camera at the origin."""
    people = [
        ArenaPerson(f"{x} {y}", ((x, y, 0.0), (x + 1, y, 0.0)), shirt=a, trousers=b) for x, y, a, b in persons
    ]
    wall = np.array([[8.0, -9.0, 8.0, 9.0]])
    arena = Arena(wall, np.empty((0, 3)), Pose(0, 0, 0), 9.0, 9.0, 2.4, people=tuple(people))
    camera = SimulatedCamera(arena, GEOMETRY, seed=seed)
    camera.people = WalkingPeople(people).shown
    camera.place(Pose(0.0, 0.0, 0.0), 0.0)
    pixels = camera.capture().pixels.astype(np.uint8)
    view = ClothesView(pixels, GEOMETRY.focal_length_px, GEOMETRY.centre_px, AHEAD, np.array([0.0, 0.0, 1.1]))
    return clothes_in(view, np.array([person[:2] for person in persons]))


def test_same_clothes_are_alike_at_other_places_and_others_are_not() -> None:
    first = seen((1.5, 0.0, RED, BLUE))[0]
    again, other, half = seen(
        (2.5, 0.6, RED, BLUE), (2.5, -0.9, GREEN, (30, 30, 32)), (3.5, 0.0, RED, GREEN), seed=1
    )
    assert first is not None and again is not None and other is not None and half is not None
    assert similarity(first, again) == pytest.approx(1.0, abs=0.15)
    assert (similarity(first, other) or 0.0) < 0.4
    assert 0.4 < (similarity(first, half) or 0.0) < 0.7


def test_person_behind_another_one_is_not_seen_well() -> None:
    front, behind, beside = seen((1.5, 0.0, RED, BLUE), (3.0, 0.1, GREEN, BLUE), (3.0, 1.0, GREEN, BLUE))
    assert front is not None
    assert behind is None
    assert beside is not None


def test_person_out_of_the_picture_is_not_seen() -> None:
    assert seen((-2.0, 0.0, RED, BLUE), (1.0, 3.0, RED, BLUE), (7.0, 0.0, RED, BLUE)) == [None, None, None]


def test_part_out_of_the_picture_is_left_out_of_the_comparison() -> None:
    near, far = seen((0.7, 0.0, RED, BLUE))[0], seen((3.0, 0.0, RED, GREEN))[0]
    assert near is not None and far is not None
    assert np.isnan(near).any()
    assert similarity(near, far) == pytest.approx(1.0, abs=0.15)
    known = blended(near, far, 0.1)
    assert not np.isnan(known).any()
