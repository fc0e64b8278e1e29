"""What crosses a bridge, read from the settings of a profile."""

import pytest

from robbie_mp.connect.bridge.driving import drive_command
from robbie_mp.connect.bridge.mapping import MAX_NAMES, BridgeMap, Incoming, MappingError, Quality, SentAs
from robbie_mp.messages import (
    DriveCommand,
    Header,
    NavigateTo,
    PoseStamped,
    Time,
    Twist,
    TwistStamped,
    Vector3,
)

SCAN = "sensor_msgs/msg/LaserScan"
IMAGE = "sensor_msgs/msg/Image"
POSE = "geometry_msgs/msg/PoseStamped"


def test_first_matching_pattern_names_what_is_sent() -> None:
    names = BridgeMap(
        {"LaserScan front": "/scan best_effort depth=5", "sensor_msgs/*": "all/{topic}"}, {}, "red"
    )
    assert names.sent_as(SCAN, "front") == SentAs("/scan", Quality(is_reliable=False, depth=5))
    assert names.sent_as(SCAN, "rear") == SentAs("/red/all/rear", Quality())
    assert names.sent_as(IMAGE, "") == SentAs("/red/all/image", Quality())
    assert names.sent_as(POSE, "goal") is None


def test_topic_becomes_a_name_that_ros_allows() -> None:
    names = BridgeMap({"*": ""}, {})
    sent = names.sent_as(IMAGE, "camera-1/2d")
    assert sent is not None
    assert sent.name == "/camera_1/_2d"


def test_second_type_under_a_name_is_not_sent() -> None:
    names = BridgeMap({"*": "/one"}, {})
    assert names.sent_as(SCAN, "")
    assert names.sent_as(IMAGE, "") is None
    assert names.sent_as(SCAN, "other")
    assert (names.clashes, names.owner("/one")) == (1, SCAN)


def test_remembered_names_are_limited() -> None:
    names = BridgeMap({"*": ""}, {})
    sent = [names.sent_as(SCAN, f"topic{number}") for number in range(MAX_NAMES + 1)]
    assert sent[0] is not None
    assert sent[-1] is None


def test_accepted_messages_have_a_type_and_a_topic() -> None:
    accept = {
        "/goal_pose": "PoseStamped goal",
        "pose": "geometry_msgs/PoseStamped latched depth=1",
        "/cmd_vel": "Twist as DriveCommand teleop best_effort",
        "/move_base_simple/goal": "PoseStamped as NavigateTo",
        "/initialpose": "PoseWithCovarianceStamped as PoseStamped initial_pose",
    }
    names = BridgeMap({}, accept, "/red")
    assert names.incoming == [
        Incoming("/goal_pose", POSE, "goal", None, Quality()),
        Incoming("/red/pose", POSE, "pose", None, Quality(is_latched=True, depth=1)),
        Incoming("/cmd_vel", "geometry_msgs/msg/Twist", "teleop", DriveCommand, Quality(is_reliable=False)),
        Incoming("/move_base_simple/goal", POSE, "", NavigateTo, Quality()),
        Incoming(
            "/initialpose",
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            "initial_pose",
            PoseStamped,
            Quality(),
        ),
    ]


@pytest.mark.parametrize(
    ("send", "accept", "problem"),
    [
        ({"LaserScan a b": "/scan"}, {}, "with a space between"),
        ({"LaserScan": "/1scan"}, {}, "'/1scan' is not a name such as '/scan'"),
        ({"LaserScan": "/scan fast"}, {}, "'fast' is not a quality of service: expected reliable"),
        ({"LaserScan": "/scan depth=0"}, {}, "depth=1 to depth=1000"),
        ({}, {"/goal": ""}, "expected a type"),
        ({}, {"/goal": "PoseStampt"}, "did you mean"),
        ({}, {"/goal pose": "PoseStamped"}, "not a name"),
        (
            {},
            {"/gas": "nose_msgs/* gas"},
            "is a pattern; this bridge accepts only types that the robot knows",
        ),
        ({}, {"/goal": "PoseStamped as DriveCommand"}, "can become a DriveCommand"),
        ({}, {"/goal": "PoseStamped as NavigateTo latched"}, "cannot be latched"),
        ({}, {"/cmd_vel": "Twist as DriveCommand latched"}, "cannot be latched"),
        ({}, {"/goal": "PoseStamped goal other"}, "'other' is not a quality of service"),
    ],
)
def test_wrong_lines_are_explained(send: dict[str, str], accept: dict[str, str], problem: str) -> None:
    with pytest.raises(MappingError, match=problem):
        BridgeMap(send, accept)


def test_a_bridge_that_learns_types_accepts_patterns() -> None:
    accept = {"/gas": "nose_msgs/* smell latched", "/any": "*"}
    gas, other = BridgeMap({}, accept, takes_foreign=True).incoming
    assert (gas.topic, gas.is_foreign, gas.quality.is_latched, other.topic) == ("smell", True, True, "any")
    assert gas.matches("nose_msgs/msg/Gas")
    assert not gas.matches("ear_msgs/msg/Noise")
    assert other.matches("ear_msgs/msg/Noise")
    with pytest.raises(MappingError, match="can become a DriveCommand"):
        BridgeMap({}, {"/cmd_vel": "* as DriveCommand"}, takes_foreign=True)


def test_velocity_becomes_a_command_that_expires() -> None:
    twist = Twist(linear=Vector3(x=0.5), angular=Vector3(z=-1.0))
    for velocity in (twist, TwistStamped(twist=twist)):
        command = drive_command(velocity, Time(sec=7), valid_for_s=0.5, waited_s=0.2)
        assert command is not None
        assert (command.linear_m_per_s, command.angular_rad_per_s) == (0.5, -1.0)
        assert command.valid_for.nanoseconds == 300_000_000
        assert command.header.stamp == Time(sec=7)


def test_stamp_of_a_velocity_bounds_its_age() -> None:
    stamped = TwistStamped(header=Header(stamp=Time(sec=7)))
    later = Time(sec=7, nanosec=200_000_000)
    command = drive_command(stamped, later, valid_for_s=0.5)
    assert command is not None
    assert command.valid_for.nanoseconds == 300_000_000
    assert command.based_on == Time(sec=7)
    assert drive_command(stamped, Time(sec=8), valid_for_s=0.5) is None
    ahead = drive_command(stamped, Time(sec=5), valid_for_s=0.5, waited_s=0.1)
    assert ahead is not None
    assert ahead.valid_for.nanoseconds == 400_000_000, "a clock that is ahead makes nothing younger"


def test_velocity_that_has_waited_too_long_or_is_not_finite_moves_nothing() -> None:
    assert drive_command(Twist(), Time(), valid_for_s=0.5, waited_s=0.5) is None
    assert drive_command(Twist(linear=Vector3(x=float("nan"))), Time(), valid_for_s=0.5) is None
    assert drive_command(Twist(angular=Vector3(z=float("inf"))), Time(), valid_for_s=0.5) is None
