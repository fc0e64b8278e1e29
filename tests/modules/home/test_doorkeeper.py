"""Somebody in the simulation opens the door for which the robot asks."""

from collections.abc import Iterator

import pytest

from robbie_mp import ModuleHarness, Time
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.pose import Pose
from robbie_robots.modules.devices.commanded_base import odometry
from robbie_robots.modules.devices.simulated_world import DoorMoved, MoveDoor
from robbie_robots.modules.home.doorkeeper import SimulatedDoorkeeper
from robbie_robots.modules.speech.messages import Say
from robbie_robots.workers.home.household import OPEN_DOOR
from tests._support.places import ARENAS

SETTINGS: dict[str, object] = {"arena": ARENAS / "apartment.yaml"}
BEFORE_DOOR, FAR_AWAY = Pose(1.4, 0.0, 1.5), Pose(6.0, -2.0, 0.0)


@pytest.fixture
def keeper() -> Iterator[ModuleHarness[SimulatedDoorkeeper]]:
    with ModuleHarness(SimulatedDoorkeeper, SETTINGS) as harness:
        yield harness


def ask(keeper: ModuleHarness[SimulatedDoorkeeper], place: Pose, text: str, seconds: float) -> list[MoveDoor]:
    """Have the robot stand at a place of the map and say something; return the requests until the end."""
    begin_s = keeper.clock.monotonic_ns() / 1e9
    for tenth in range(round(10 * seconds)):
        now_s = begin_s + tenth / 10
        truth = odometry(DriveState(now_s, place, 0.0, 0.0), Time.from_nanoseconds(round(now_s * 1e9)), "map")
        keeper.send(truth, topic="ground_truth")
        if tenth == 0:
            keeper.send(Say(text=text))
        keeper.advance(0.1)
    return keeper.take(MoveDoor)


def test_door_near_the_robot_is_opened_a_while_after_the_robot_has_asked(
    keeper: ModuleHarness[SimulatedDoorkeeper],
) -> None:
    assert ask(keeper, BEFORE_DOOR, OPEN_DOOR.format("bedroom"), 2.5) == []
    (request,) = ask(keeper, BEFORE_DOOR, "", 1.0)
    assert (request.door, request.open) == ("bedroom", True)
    keeper.reply(request, DoorMoved())
    assert keeper.checkpoint is None
    assert ask(keeper, BEFORE_DOOR, "", 5.0) == []


def test_nobody_opens_a_door_that_is_far_away_or_was_not_asked_for(
    keeper: ModuleHarness[SimulatedDoorkeeper],
) -> None:
    assert ask(keeper, FAR_AWAY, OPEN_DOOR.format("bedroom"), 5.0) == []
    assert ask(keeper, BEFORE_DOOR, "Here is the soup.", 5.0) == []


def test_request_survives_a_restart_and_is_repeated_until_the_door_turns(
    keeper: ModuleHarness[SimulatedDoorkeeper],
) -> None:
    ask(keeper, BEFORE_DOOR, OPEN_DOOR.format("bedroom"), 2.0)
    with ModuleHarness(SimulatedDoorkeeper, SETTINGS, restored=keeper.checkpoint) as again:
        (first,) = ask(again, BEFORE_DOOR, "", 3.5)[:1]
        again.refuse(first, "the base restarts")
        (second,) = ask(again, BEFORE_DOOR, "", 1.5)[:1]
        assert second.door == "bedroom"
