"""Objects are named by what is printed on them where that is certain, and otherwise by their size."""

import numpy as np
import pytest

from robbie_robots.workers.manipulation.object_names import ObjectNamer, Prints, overlap
from robbie_robots.workers.taught import Box, Sighting

KNOWN = ["tea", "soup"]
BOX = ["tea"]
"""Names of the known objects of the size of both boxes."""
LEFT, RIGHT = np.array([[0.1, 0.2, 0.0], [0.2, 0.3, 0.0]]), np.array([[0.5, 0.2, 0.0], [0.6, 0.3, 0.0]])
"""The points of two objects; the camera of the tests looks along z from 1 m, with 100 pixels to a metre."""
AT_LEFT, AT_RIGHT = Box(10, 20, 10, 10), Box(50, 20, 10, 10)


def prints(*sightings: Sighting, taught: tuple[str, ...] = ("tea", "mint")) -> Prints:
    X_CB = np.eye(4)
    X_CB[2, 3] = 1.0
    return Prints(sightings, frozenset(taught), X_CB, 100.0, (0.0, 0.0))


def test_objects_of_one_size_are_told_apart_by_their_prints() -> None:
    for left, right in (("tea", "mint"), ("mint", "tea")):
        seen = prints(Sighting(left, 0.9, AT_LEFT), Sighting(right, 0.9, AT_RIGHT))
        assert ObjectNamer(KNOWN).names([LEFT, RIGHT], [BOX, BOX], seen) == [left, right]


def test_object_without_a_known_size_is_named_by_its_print() -> None:
    seen = prints(Sighting("mint", 0.9, AT_RIGHT))
    assert ObjectNamer(KNOWN).names([LEFT, RIGHT], [[], []], seen) == ["", "mint"]


def test_what_was_not_taught_is_named_by_its_size() -> None:
    namer = ObjectNamer(KNOWN)
    assert namer.names([LEFT, RIGHT], [BOX, BOX], None) == ["tea", ""]
    seen = prints(Sighting("mint", 0.9, AT_LEFT), taught=("mint",))
    assert namer.names([LEFT, RIGHT], [BOX, BOX], seen) == ["mint", "tea"]


def test_taught_name_is_given_by_size_only_if_nothing_else_can_be_meant() -> None:
    namer = ObjectNamer(KNOWN)
    # Nothing else was taught, and there is only one of this size.
    assert namer.names([LEFT], [BOX], prints(taught=("tea",))) == ["tea"]
    assert namer.names([LEFT, RIGHT], [BOX, BOX], prints(taught=("tea",))) == ["", ""]
    # Once seen, the mint is known to have the same size; so what shows no print may be either.
    seen = prints(Sighting("mint", 0.9, AT_LEFT))
    assert namer.names([LEFT, RIGHT], [BOX, BOX], seen) == ["mint", "tea"]
    assert namer.names([LEFT], [BOX], prints()) == [""]
    again = ObjectNamer(KNOWN)
    again.remember(namer.memory())
    assert again.names([LEFT], [BOX], prints()) == [""]
    # Half hidden, it seems to have another size; that changes nothing.
    assert again.names([LEFT], [[]], prints(Sighting("mint", 0.9, AT_LEFT))) == ["mint"]
    assert again.names([LEFT], [BOX], prints()) == [""]
    # When it is forgotten, it is no reason for doubt any more.
    assert again.names([LEFT], [BOX], prints(taught=("tea",))) == ["tea"]


def test_known_objects_of_one_size_that_were_taught_are_not_guessed() -> None:
    both = ["tea", "mint"]
    assert ObjectNamer(KNOWN).names([LEFT], [both], prints()) == [""]
    assert ObjectNamer(KNOWN).names([LEFT, RIGHT], [both, both], None) == ["tea", "mint"]
    # The mint was not taught, so nothing but its size can say that it is one; the other is no tea for that.
    assert ObjectNamer(KNOWN).names([LEFT, RIGHT], [both, both], prints(taught=("tea",))) == ["mint", ""]


@pytest.mark.parametrize(
    "sighting",
    [
        Sighting("mint", 0.65, AT_LEFT),  # not certain
        Sighting("mint", 0.9, Box(16, 26, 30, 30)),  # hardly on the object
        Sighting("soup", 0.9, AT_LEFT),  # the soup is known to have another size
        Sighting("", 0.9, AT_LEFT),
    ],
)
def test_doubtful_sighting_gives_no_name(sighting: Sighting) -> None:
    seen = prints(sighting, taught=("mint", "soup"))
    assert ObjectNamer(KNOWN).names([LEFT, RIGHT], [[], []], seen) == ["", ""]


def test_sightings_of_the_same_object_give_it_the_name_that_fits_best() -> None:
    seen = prints(Sighting("tea", 0.99, Box(12, 22, 10, 10)), Sighting("mint", 0.8, AT_LEFT))
    assert ObjectNamer(KNOWN).names([LEFT], [BOX], seen) == ["mint"]


def test_what_is_behind_the_camera_has_no_place_in_the_picture() -> None:
    behind = LEFT - [0.0, 0.0, 2.0]
    assert ObjectNamer(KNOWN).names([behind], [BOX], prints(Sighting("mint", 0.9, AT_LEFT))) == ["tea"]
    assert overlap(Box(0, 0, 0, 0), Box(0, 0, 0, 0)) == 0.0
