"""Ill-formed messages from outside are refused where they come in, with their type and reason."""

import logging
import math
import time
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.module import Link
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.connect.ros1.module import Ros1Bridge
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.logs.playback.outlet import BusOutlet
from robbie_mp.logs.playback.translation import Translation
from robbie_mp.logs.recording.reader import LoggedMessage
from robbie_mp.messages import (
    DriveCommand,
    Duration,
    LinkRefusal,
    LinkState,
    MapMetaData,
    Message,
    OccupancyGrid,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
)
from robbie_mp.messages.refusals import Refusals
from robbie_mp.station.page import page as page_module
from robbie_mp.station.page.page import Page
from robbie_mp.station.web.access import Role
from tests.connect.ros1.test_module import arrive

FAR = Odometry(pose=PoseWithCovariance(pose=Pose(position=Point(x=1e12))))
NOWHERE = OccupancyGrid(info=MapMetaData(origin=Pose(position=Point(x=math.nan))))
FOR_AN_HOUR = DriveCommand(linear_m_per_s=0.3, valid_for=Duration(sec=3600))
WRONG = [
    (FAR, "pose.pose.position.x"),
    (NOWHERE, "info.origin.position.x"),
    (FOR_AN_HOUR, "valid_for"),
]


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    open_session(Endpoints()).close()
    with ModuleHarness(Ros2Bridge, {"connect": []}) as bridge:
        bridge.advance(0.02)


@pytest.mark.parametrize(("message", "field"), WRONG, ids=lambda one: str(one)[:20])
def test_link_refuses_an_ill_formed_message(message: Message, field: str) -> None:
    settings = {"robot": "blue", "listen": [], "robots": ["red"], "accept": {"red": ["*"]}}
    with ModuleHarness(Link, settings) as harness:
        link = harness.module
        name = ChannelId(message.type_name, message.version, "odom")
        arrived = Arrived("red", 1, TrafficClass.RELIABLE, 0, name, message.encode(), 0, 0, False)
        assert link.on_arrived(arrived) is Fate.REFUSED
        good = arrived._replace(name=name, data=type(message)().encode())
        assert isinstance(message, DriveCommand) or link.on_arrived(good) is Fate.PUBLISHED
        assert link.ill_formed.by_kind == {(message.type_name, field): 1}
        harness.advance(1.1)
        assert "1 ill-formed refused" in link.status
        state = harness.take(LinkState)[-1]
        assert state.ill_formed == [LinkRefusal(message_type=message.type_name, field=field, refused=1)]


@pytest.mark.parametrize(("message", "field"), WRONG[:2], ids=lambda one: str(one)[:20])
def test_bridges_to_ros_refuse_an_ill_formed_message(message: Message, field: str) -> None:
    accept = {"/a": f"{type(message).__name__} a"}
    with ModuleHarness(Ros1Bridge, {"master": "http://127.0.0.1:1", "accept": accept}) as bridge:
        assert not arrive(bridge, "/a", message)
        assert arrive(bridge, "/a", type(message)())
        assert bridge.module.ill_formed.by_kind == {(message.type_name, field): 1}
    with ModuleHarness(Ros2Bridge, {"connect": [], "accept": accept}) as ros2:
        (channel,) = ros2.module._incoming
        for one in (message, type(message)()):
            ros2.module.inbox.put(channel, one.encode(), time.time_ns())
            ros2.advance(0.02)
        assert ros2.module.ill_formed.by_kind == {(message.type_name, field): 1}
        assert (ros2.module.refused, len(ros2.published_encoded)) == (1, 1)


@pytest.mark.parametrize(("message", "field"), WRONG, ids=lambda one: str(one)[:20])
def test_play_of_a_log_skips_an_ill_formed_message(message: Message, field: str) -> None:
    module: Any = Mock()
    module.ill_formed = Refusals(logging.getLogger("test"))
    outlet = BusOutlet(module, {1: Translation(message.version, None)}, lambda _: None)
    channel: Any = Mock(id=1, type_name=message.type_name, topic="a")
    assert outlet.send(LoggedMessage(channel, 1, 0, message.encode()))
    assert outlet.skipped == 1
    assert module.ill_formed.by_kind == {(message.type_name, field): 1}
    module.publish_encoded.assert_not_called()


@pytest.mark.parametrize(("message", "field"), WRONG, ids=lambda one: str(one)[:20])
def test_page_sends_no_ill_formed_message_and_says_why(
    message: Message, field: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "ui", Mock())
    monkeypatch.setattr(Page, "role", Role.OPERATOR)
    station = Mock()
    station.ill_formed = Refusals(logging.getLogger("test"))
    page = Page("key", "session", Mock(), station, Mock())
    assert not page.publish(message, "the message")
    station.publish.assert_not_called()
    said = page_module.ui.notify.call_args.args[0]  # type: ignore[attr-defined]
    assert said.startswith("the message was refused") and field in said
    assert station.ill_formed.by_kind == {(message.type_name, field): 1}
