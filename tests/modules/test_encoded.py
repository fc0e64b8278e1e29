"""A module that receives and publishes encoded messages, tested without processes."""

import pytest

from robbie_mp import EncodedMessage, Envelope, Module, ModuleHarness
from robbie_mp.messages import DecodeError, DriveCommand, LaserScan
from robbie_mp.module.harness import NotSubscribed, PublishedEncoded
from robbie_mp.module.subscriptions import EmptyPattern, SubscribedTwice

SECRET = b"\x00\x01\x00\x00\x07"


class Mirror(Module):
    """Publishes all messages again that are not about driving, and records them."""

    def setup(self) -> None:
        self.came: list[tuple[str, Envelope]] = []
        self.subscribe(DriveCommand, self.on_drive)
        self.subscribe_encoded("*/DriveCommand", self.on_driving)
        self.subscribe_encoded("*", self.on_other, topic="l*")

    def on_drive(self, _command: DriveCommand) -> None:
        self.came.append(("typed", self.envelope))

    def on_driving(self, _message: EncodedMessage) -> None:
        self.came.append(("driving", self.envelope))

    def on_other(self, message: EncodedMessage) -> None:
        self.came.append(("other", self.envelope))
        self.publish_encoded(message.type_name, message.version, message.data, topic="mirror")


def test_message_arrives_once_by_pattern_and_once_by_type() -> None:
    with ModuleHarness(Mirror) as harness:
        harness.send(DriveCommand(), topic="left")
        assert [who for who, _ in harness.module.came] == ["typed", "driving"]
        with pytest.raises(NotSubscribed):
            harness.send(LaserScan(), topic="right")
        harness.send(LaserScan(), topic="left", sender="laser")
        assert [who for who, _ in harness.module.came[2:]] == ["other"]
        envelope = harness.module.came[-1][1]
        assert (envelope.topic, envelope.sender, envelope.sequence) == ("left", "laser", 3)


def test_messages_of_an_unknown_type_are_delivered() -> None:
    with ModuleHarness(Mirror) as harness:
        harness.send_encoded("team_msgs/msg/Secret", 2, SECRET, topic="l")
        assert harness.published_encoded == [PublishedEncoded("team_msgs/msg/Secret", 2, SECRET, "mirror")]


def test_invalid_bytes_and_repeated_patterns_are_refused() -> None:
    with ModuleHarness(Mirror) as harness:
        with pytest.raises(DecodeError):
            harness.module.publish_encoded("team_msgs/msg/Secret", 2, b"\x00\x01")
        with pytest.raises(SubscribedTwice):
            harness.module.subscribe_encoded("*/DriveCommand", print)


def test_empty_pattern_is_refused_as_in_a_robot() -> None:
    with ModuleHarness(Mirror) as harness, pytest.raises(EmptyPattern, match="matches all"):
        harness.module.subscribe_encoded("", print)
