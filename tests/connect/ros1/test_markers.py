"""Victims and points of interest become markers, which rosbags reads as RViz of ROS 1 would."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from robbie_mp.connect.ros1.conversion import ros1_type
from robbie_mp.connect.ros1.markers import MARKER_ARRAY, MAX_PLACES, ShownPlace, ShownPlaces, can_be_markers
from robbie_mp.connect.ros1.module import Ros1Bridge
from robbie_mp.connect.ros1.ros_node import MESSAGE, pack
from robbie_mp.messages import (
    Header,
    LaserScan,
    Message,
    Point,
    PointOfInterest,
    PointsOfInterest,
    Pose,
    message_type_from_schema,
    schema_text,
)
from robbie_mp.module.harness import ModuleHarness
from robbie_mp.module.settings import SettingError
from robbie_robots.modules.rescue.messages import VictimFound

NOETIC = get_typestore(Stores.ROS1_NOETIC)
NAME = "visualization_msgs/msg/MarkerArray"
SPHERE, TEXT, DELETE_ALL = 2, 9, 3


def places(*names: str, x: float = 1.0) -> PointsOfInterest:
    points = [PointOfInterest(name=name, pose=Pose(position=Point(x=x, y=2.0))) for name in names]
    return PointsOfInterest(header=Header(frame_id="map"), points=points)


def victim(number: int, state: int) -> VictimFound:
    pose = Pose(position=Point(x=float(number)))
    return VictimFound(
        header=Header(frame_id="map"), id=number, name=f"victim {number}", pose=pose, state=state
    )


def shown(places_shown: ShownPlaces, message: Message) -> bytes:
    """The markers after a further message."""
    places_shown.add(message.encode())
    return places_shown.markers()


def read(encoded: bytes) -> list[Any]:
    """Read markers as ROS 1 does."""
    array: Any = NOETIC.deserialize_ros1(ros1_type(MARKER_ARRAY).to_ros1(encoded), NAME)
    return list(array.markers)


SEND = {"PointsOfInterest": "/places as MarkerArray", "LaserScan": "/scan as MarkerArray"}
SETTINGS = {"master": "http://127.0.0.1:1", "send": SEND}


@pytest.fixture
def bridge() -> Iterator[ModuleHarness[Ros1Bridge]]:
    with ModuleHarness(Ros1Bridge, SETTINGS) as harness:
        yield harness


def kept(bridge: ModuleHarness[Ros1Bridge]) -> list[Any]:
    """The markers that ROS keeps for those who come later."""
    (channel,) = [one for one in bridge.module._channels.values() if one]
    array: Any = NOETIC.deserialize_ros1(
        bridge.module.ros._kept[channel.number][len(pack(MESSAGE, 0, b"")) :], NAME
    )
    return list(array.markers)


def test_type_is_that_of_ros1() -> None:
    kind = ros1_type(MARKER_ARRAY)
    assert (kind.name, kind.md5) == ("visualization_msgs/MarkerArray", NOETIC.generate_msgdef(NAME, 1)[1])


def test_each_message_has_all_places_of_its_topic() -> None:
    places_shown = ShownPlaces(PointsOfInterest)
    clear, home, name, *rest = read(shown(places_shown, places("home")))
    assert (clear.action, rest) == (DELETE_ALL, [])
    assert (home.type, home.action, home.header.frame_id) == (SPHERE, 0, "map")
    assert (home.pose.position.x, home.pose.position.y, home.color.a) == (1.0, 2.0, 1.0)
    assert (name.type, name.text) == (TEXT, "home")
    assert len({home.id, name.id}) == 2
    assert [one.text for one in read(shown(places_shown, places("door", "exit")))[2::2]] == ["door", "exit"]


@pytest.mark.parametrize("as_robot_knows_it", [False, True])
def test_victims_are_kept_by_their_number_and_show_their_state(as_robot_knows_it: bool) -> None:
    kind: type[Message] = VictimFound
    if as_robot_knows_it:  # the bridge has no class of the robot's own types, only their definitions
        kind = message_type_from_schema(VictimFound.type_name, schema_text(VictimFound))
    places_shown = ShownPlaces(kind)
    shown(places_shown, victim(1, VictimFound.SUSPECTED))
    shown(places_shown, victim(7, VictimFound.ASKED))
    _, first, first_name, second, second_name = read(shown(places_shown, victim(1, VictimFound.CONFIRMED)))
    assert [first_name.text, second_name.text] == ["victim 1: confirmed", "victim 7: asked"]
    assert first.color.g > first.color.r and second.color.r > second.color.g
    assert second.pose.position.x == 7.0


def test_places_beyond_the_limit_or_nowhere_are_left_out_and_counted() -> None:
    places_shown = ShownPlaces(VictimFound)
    for number in range(MAX_PLACES):
        places_shown._places[number] = ShownPlace("map", 0.0, 0.0, 0.0, "", 0)
    places_shown.add(victim(MAX_PLACES, 0).encode())
    assert places_shown.left_out == 1
    found = read(shown(ShownPlaces(PointsOfInterest), places("lost", x=math.nan)))
    assert len(found) == 1


def test_bridge_keeps_markers_for_those_who_come_later(bridge: ModuleHarness[Ros1Bridge]) -> None:
    bridge.send(places("home"), sender="mission")
    assert [one.text for one in kept(bridge)] == ["", "", "home"]


def test_places_outlive_the_bridge(bridge: ModuleHarness[Ros1Bridge]) -> None:
    bridge.send(places("home"), topic="mission", sender="mission")
    with ModuleHarness(Ros1Bridge, SETTINGS, restored=bridge.checkpoint) as restarted:
        assert [one.text for one in kept(restarted)] == ["", "", "home"]
        restarted.send(places("door"), topic="mission", sender="mission")
        assert [one.text for one in kept(restarted)] == ["", "", "door"]
    with ModuleHarness(Ros1Bridge, SETTINGS | {"send": {}}, restored=bridge.checkpoint) as changed:
        assert changed.module.ros._kept == {}  # the profile was changed meanwhile


def test_what_has_no_place_is_not_sent(bridge: ModuleHarness[Ros1Bridge]) -> None:
    bridge.send(LaserScan(), sender="laser")
    assert bridge.module.refused == 1
    assert can_be_markers(VictimFound) and not can_be_markers(LaserScan)


def test_only_markers_can_be_made() -> None:
    with pytest.raises(SettingError, match="can become only MarkerArray"):
        ModuleHarness(Ros1Bridge, {"send": {"LaserScan": "/scan as PointCloud"}})
