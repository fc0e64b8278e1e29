"""A link drops what would move the robot too late, and never the stop."""

import pytest

from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.receiving import Arrived
from robbie_mp.connect.link.safety import Ages, expires, shortened
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.messages import (
    DriveCommand,
    Duration,
    EmergencyStop,
    Header,
    JointCommand,
    Message,
    PanTiltCommand,
    String,
    Time,
    replace,
)

MS = 1_000_000
NOW_NS = 5_000_000 * MS
LIMIT_NS = 300 * MS
THEIR_NS = 9_000_000 * MS
"""The present time by the other robot's clock of stamps, which nobody here knows."""


def arrived(message: Message, traffic: TrafficClass = TrafficClass.COMMAND) -> Arrived:
    name = ChannelId(message.type_name, message.version, "topic")
    return Arrived("laptop", 1, traffic, 0, name, message.encode(), 0, 0, False)


def aged(age_ms: int) -> Ages:
    return Ages(age_ms * MS, age_ms * MS)


def their(stamp_ns: int) -> Time:
    return Time.from_nanoseconds(THEIR_NS + stamp_ns)


def test_a_drive_command_lasts_as_much_shorter_as_it_was_under_way() -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220 * MS))
    data = shortened(arrived(command), Ages(90 * MS, 110 * MS), NOW_NS, LIMIT_NS)
    assert data is not None
    left = DriveCommand.decode(data)
    assert left.valid_for.nanoseconds == 120 * MS
    assert left.linear_m_per_s == 0.5


def test_a_joint_command_lasts_as_much_shorter_as_it_was_under_way() -> None:
    command = JointCommand(name=["gripper"], valid_for=Duration.from_nanoseconds(220 * MS))
    data = shortened(arrived(command), aged(100), NOW_NS, LIMIT_NS)
    assert data is not None
    assert JointCommand.decode(data).valid_for.nanoseconds == 120 * MS
    assert shortened(arrived(command), aged(220), NOW_NS, LIMIT_NS) is None


@pytest.mark.parametrize("age_ms", [220, 500])
def test_a_drive_command_whose_time_is_over_is_thrown_away(age_ms: int) -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220 * MS))
    assert shortened(arrived(command), aged(age_ms), NOW_NS, LIMIT_NS) is None


def test_a_drive_command_that_cannot_be_read_is_thrown_away() -> None:
    message = arrived(DriveCommand())
    damaged = message._replace(data=message.data[:9])
    assert shortened(damaged, aged(0), NOW_NS, LIMIT_NS) is None


def test_other_commands_are_published_as_they_are() -> None:
    message = arrived(String(data="left"))
    assert shortened(message, aged(100), NOW_NS, LIMIT_NS) == message.data


@pytest.mark.parametrize("traffic", [TrafficClass.URGENT, TrafficClass.COMMAND, TrafficClass.RELIABLE])
def test_an_emergency_stop_never_comes_too_late_but_its_release_does(traffic: TrafficClass) -> None:
    assert not expires(arrived(EmergencyStop(engaged=True), traffic))
    assert expires(arrived(EmergencyStop(engaged=False), traffic))


def test_only_commands_expire() -> None:
    assert expires(arrived(String(), TrafficClass.COMMAND))
    assert not expires(arrived(String(), TrafficClass.STATE))
    assert not expires(arrived(String(), TrafficClass.RELIABLE))


@pytest.mark.parametrize("traffic", TrafficClass)
@pytest.mark.parametrize("command_type", [DriveCommand, JointCommand, PanTiltCommand])
def test_what_moves_a_robot_expires_in_whatever_class_it_comes(
    command_type: type[Message], traffic: TrafficClass
) -> None:
    """One that was stored arrived after the network was back, and by a clock that is ahead it was fresh."""
    assert expires(arrived(command_type(), traffic))


@pytest.mark.parametrize("command_type", [DriveCommand, JointCommand, PanTiltCommand])
def test_stamps_of_a_command_become_those_of_this_robot_with_the_greatest_age(
    command_type: type[DriveCommand | JointCommand | PanTiltCommand],
) -> None:
    command = command_type(
        header=Header(stamp=their(0)), valid_for=Duration.from_nanoseconds(500 * MS), based_on=their(-50 * MS)
    )
    data = shortened(arrived(command), Ages(80 * MS, 120 * MS), NOW_NS, LIMIT_NS)
    assert data is not None
    here = command_type.decode(data)
    assert here.header.stamp.nanoseconds == NOW_NS - 120 * MS
    assert here.based_on.nanoseconds == NOW_NS - 170 * MS


@pytest.mark.parametrize(("rested_ms", "age_ms"), [(250, 60), (0, 301), (10_000, 0), (-5_000, 0)], ids=str)
def test_command_that_rests_on_what_is_too_old_or_in_the_future_is_refused(
    rested_ms: int, age_ms: int
) -> None:
    moving = DriveCommand(
        header=Header(stamp=their(0)),
        linear_m_per_s=0.5,
        valid_for=Duration(sec=1),
        based_on=their(-rested_ms * MS),
    )
    assert shortened(arrived(moving), aged(age_ms), NOW_NS, LIMIT_NS) is None
    standing = replace(moving, linear_m_per_s=0.0)
    assert shortened(arrived(standing), aged(age_ms), NOW_NS, LIMIT_NS) is not None


def test_command_that_does_not_say_what_it_rests_on_still_does_not() -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration(sec=1))
    data = shortened(arrived(command), aged(10), NOW_NS, LIMIT_NS)
    assert data is not None
    assert DriveCommand.decode(data).based_on == Time()


def test_a_command_that_stamps_what_it_rests_on_and_not_itself_is_refused() -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration(sec=1), based_on=their(0))
    assert shortened(arrived(command), aged(10), NOW_NS, LIMIT_NS) is None
