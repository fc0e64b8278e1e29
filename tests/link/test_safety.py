"""A link throws away what would move the robot too late, and never the stop."""

import pytest

from robbie_mp.link.header import ChannelId
from robbie_mp.link.receiving import Arrived
from robbie_mp.link.safety import expires, shortened
from robbie_mp.link.traffic import TrafficClass
from robbie_mp.messages import DriveCommand, Duration, EmergencyStop, JointCommand, Message, String

MS = 1_000_000


def arrived(message: Message, traffic: TrafficClass = TrafficClass.COMMAND) -> Arrived:
    name = ChannelId(message.type_name, message.version, "topic")
    return Arrived("laptop", 1, traffic, 0, name, message.encode(), 0, 0, False, ("laptop",))


def test_a_drive_command_lasts_as_much_shorter_as_it_was_under_way() -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220 * MS))
    data = shortened(arrived(command), 100 * MS)
    assert data is not None
    left = DriveCommand.decode(data)
    assert left.valid_for.nanoseconds == 120 * MS
    assert left.linear_m_per_s == 0.5


def test_a_joint_command_lasts_as_much_shorter_as_it_was_under_way() -> None:
    command = JointCommand(name=["gripper"], valid_for=Duration.from_nanoseconds(220 * MS))
    data = shortened(arrived(command), 100 * MS)
    assert data is not None
    assert JointCommand.decode(data).valid_for.nanoseconds == 120 * MS
    assert shortened(arrived(command), 220 * MS) is None


@pytest.mark.parametrize("age_ms", [220, 500])
def test_a_drive_command_whose_time_is_over_is_thrown_away(age_ms: int) -> None:
    command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220 * MS))
    assert shortened(arrived(command), age_ms * MS) is None


def test_a_drive_command_that_cannot_be_read_is_thrown_away() -> None:
    message = arrived(DriveCommand())
    damaged = message._replace(data=message.data[:9])
    assert shortened(damaged, 0) is None


def test_other_commands_are_published_as_they_are() -> None:
    message = arrived(String(data="left"))
    assert shortened(message, 100 * MS) == message.data


@pytest.mark.parametrize("traffic", [TrafficClass.URGENT, TrafficClass.COMMAND, TrafficClass.RELIABLE])
def test_an_emergency_stop_never_comes_too_late_but_its_release_does(traffic: TrafficClass) -> None:
    assert not expires(arrived(EmergencyStop(engaged=True), traffic))
    assert expires(arrived(EmergencyStop(engaged=False), traffic))


def test_only_commands_expire() -> None:
    assert expires(arrived(String(), TrafficClass.COMMAND))
    assert not expires(arrived(String(), TrafficClass.STATE))
    assert not expires(arrived(String(), TrafficClass.RELIABLE))
