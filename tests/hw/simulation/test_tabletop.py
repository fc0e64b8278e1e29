"""Simulated objects are grasped, carried, put down, dropped and knocked over."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.hw.simulation.tabletop import TableObject, Tabletop

TABLE = Placed(Solid((0.6, 1.0, 0.4)), pose_at((0.5, 0.0, 0.2)))
CAN = TableObject("can", Solid((0.06, 0.06, 0.1), is_round=True), pose_at((0.4, 0.0, 0.45)))
BOX = TableObject("box", Solid((0.06, 0.04, 0.12)), pose_at((0.4, 0.3, 0.46)))


def hand_at(x: float, y: float, z: float, yaw_rad: float = 0.0) -> NDArray[np.float64]:
    return pose_at((x, y, z), yaw_rad)


def closed(top: Tabletop, hand: NDArray[np.float64]) -> float:
    """Close the hand in steps as the simulated arm does; return half of the opening at the end."""
    half = 0.045
    while half > 0.0:
        least = top.step(hand, half, [])
        if least and half <= least:
            return least
        half = max(half - 0.002, least)
    top.step(hand, 0.0, [])
    return 0.0


def test_gripper_stops_at_the_objects_width_and_carries_it_along() -> None:
    top = Tabletop([CAN, BOX], [TABLE])
    half = closed(top, hand_at(0.4, 0.005, 0.45))
    assert top.held == "can"
    assert half == pytest.approx(0.03, abs=0.002)
    # Both pads touch it, so it stands in their middle.
    assert top.pose("can")[1, 3] == pytest.approx(0.005, abs=0.002)
    top.step(hand_at(0.4, 0.1, 0.6, 0.5), half, [])
    assert top.pose("can")[:3, 3] == pytest.approx([0.4, 0.1, 0.6], abs=0.003)
    assert (top.knocked, top.slips, top.contacts) == ([], 0, 0)


def test_gripper_that_closes_fast_does_not_pass_through_the_object() -> None:
    top = Tabletop([CAN], [TABLE])
    assert top.step(hand_at(0.4, 0.0, 0.45), 0.045, []) == 0.0
    assert top.step(hand_at(0.4, 0.0, 0.45), 0.01, []) == pytest.approx(0.03, abs=0.002)
    assert top.held == "can"


def test_empty_hand_closes_and_holds_nothing() -> None:
    top = Tabletop([CAN], [TABLE])
    assert closed(top, hand_at(0.4, 0.2, 0.45)) == 0.0
    assert top.held is None


def test_object_that_is_let_go_near_the_table_stands_there() -> None:
    top = Tabletop([CAN], [TABLE])
    half = closed(top, hand_at(0.4, 0.0, 0.45))
    top.step(hand_at(0.5, -0.2, 0.46), half, [])
    top.step(hand_at(0.5, -0.2, 0.46), half + 0.005, [])
    assert top.held is None
    assert top.pose("can")[:3, 3] == pytest.approx([0.5, -0.2, 0.45], abs=0.003)
    assert not top.lies("can")


@pytest.mark.parametrize(("x", "z"), [(0.5, 0.6), (1.5, 0.46)])
def test_object_that_is_let_go_high_up_or_beside_the_table_falls_over(x: float, z: float) -> None:
    top = Tabletop([CAN], [TABLE])
    half = closed(top, hand_at(0.4, 0.0, 0.45))
    top.step(hand_at(x, 0.0, z), half, [])
    top.step(hand_at(x, 0.0, z), 0.045, [])
    assert (top.held, top.knocked) == (None, ["can"])
    assert top.pose("can")[2, 3] == pytest.approx(0.43 if x < 0.8 else 0.03)


def test_object_that_a_person_takes_out_of_the_hand_is_not_in_the_room_any_more() -> None:
    top = Tabletop([CAN], [TABLE])
    half = closed(top, hand_at(0.4, 0.0, 0.45))
    top.step(hand_at(1.5, 0.0, 0.7), half, [], somebody_takes=True)
    assert (top.held, top.is_taken("can")) == ("can", False)  # as long as the gripper holds it
    top.step(hand_at(1.5, 0.0, 0.7), 0.045, [], somebody_takes=True)
    assert top.held is None
    assert top.is_taken("can")
    assert not top.knocked
    assert not top.placed()
    again = Tabletop([CAN], [TABLE], state=top.memory())
    assert again.is_taken("can")
    assert closed(again, hand_at(1.5, 0.0, 0.7)) == 0.0


def test_box_slips_if_its_faces_are_askew_and_not_if_they_are_flat() -> None:
    for yaw_rad, held in ((0.0, "box"), (0.2, "box"), (0.7, None)):
        top = Tabletop([BOX], [TABLE])
        half = closed(top, hand_at(0.4, 0.3, 0.45, yaw_rad))
        assert top.held == "box"
        top.step(hand_at(0.4, 0.3, 0.55, yaw_rad), half, [])
        assert (top.held, top.slips) == (held, held is None)


def test_arm_knocks_over_what_it_touches() -> None:
    top = Tabletop([CAN, BOX], [TABLE])
    finger = Solid((0.06, 0.012, 0.024))
    top.step(hand_at(0.4, 0.1, 0.45), 0.04, [Placed(finger, hand_at(0.4, 0.036, 0.45))])
    assert top.knocked == []
    top.step(hand_at(0.4, 0.1, 0.45), 0.04, [Placed(finger, hand_at(0.4, 0.02, 0.45))])
    assert top.knocked == ["can"]
    assert top.lies("can") and not top.lies("box")


def test_held_object_knocks_over_another() -> None:
    top = Tabletop([CAN, BOX], [TABLE])
    half = closed(top, hand_at(0.4, 0.0, 0.45))
    top.step(hand_at(0.4, 0.26, 0.46), half, [])
    assert (top.held, top.knocked) == ("can", ["box"])


def test_contacts_with_table_and_floor_are_counted_once_each() -> None:
    top = Tabletop([], [TABLE])
    link = Solid((0.1, 0.05, 0.05))
    for z, contacts in ((0.43, 0), (0.41, 1), (0.4, 1), (0.5, 1), (0.41, 2)):
        top.step(hand_at(0.0, 0.0, 1.0), 0.0, [Placed(link, pose_at((0.4, 0.0, z)))])
        assert top.contacts == contacts
    top.step(hand_at(0.0, 0.0, 1.0), 0.0, [Placed(link, pose_at((2.0, 0.0, 0.3)))])
    top.step(hand_at(0.0, 0.0, 1.0), 0.0, [Placed(link, pose_at((2.0, 0.0, 0.01)))])
    assert top.contacts == 3


def test_world_goes_on_where_its_memory_ends() -> None:
    top = Tabletop([CAN, BOX], [TABLE])
    half = closed(top, hand_at(0.4, 0.0, 0.45))
    top.step(hand_at(0.4, 0.1, 0.6), half, [])
    again = Tabletop([CAN, BOX], [TABLE], state=top.memory())
    assert again.held == "can"
    again.step(hand_at(0.5, 0.1, 0.6), half, [])
    assert again.pose("can")[:3, 3] == pytest.approx([0.5, 0.1, 0.6], abs=0.003)
    assert math.isclose(again.pose("box")[0, 3], 0.4)
