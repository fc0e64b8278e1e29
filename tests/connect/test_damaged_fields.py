"""No bridge and no link dies of a stock message with one damaged field, in either direction."""

import logging
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.connect.foxglove.module import FoxgloveServer
from robbie_mp.connect.foxglove.server import CDR, ClientChannel, FromClient
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.module import Link
from robbie_mp.connect.link.receiving import Arrived
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.connect.ros1.conversion import ConversionError, ros1_type
from robbie_mp.connect.ros1.module import Ros1Bridge
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.messages import Message, stock_registry
from robbie_mp.messages.calls import Feedback, Goal, Reply, Request, Result
from robbie_mp.module.harness import HarnessBus
from tests._support.damage import damaged, plausible

Feed = Callable[[Message], None]
STOCK = sorted(
    (one for one in stock_registry() if not issubclass(one, Request | Reply | Goal | Feedback | Result)),
    key=lambda one: one.type_name,
)
ACCEPT = {f"/t{number}": f"{one.type_name} t{number}" for number, one in enumerate(STOCK)}
PART = 60
"""Maximum number of topics that a bridge accepts in these tests."""


@pytest.fixture(scope="module", autouse=True)
def threads_have_started() -> None:
    """Zenoh and the SDK keep descriptors until the process ends; have them opened before any test looks."""
    open_session(Endpoints()).close()
    with ModuleHarness(FoxgloveServer, {"port": 0}), ModuleHarness(Ros2Bridge, {"connect": []}) as bridge:
        bridge.advance(0.02)


def outward(harness: ModuleHarness[Any]) -> Feed:
    """Return what hands a message of this robot to a bridge."""

    def feed(message: Message) -> None:
        name = ChannelName(message.type_name, message.version, "somewhere")
        harness.bus.deliver(name, message.encode(), "somebody")

    return feed


@contextmanager
def ros1(accept: dict[str, str]) -> Iterator[tuple[ModuleHarness[Any], Feed]]:
    with ModuleHarness(Ros1Bridge, {"master": "http://127.0.0.1:1", "accept": accept}) as bridge:
        known = {one.type_name: one for one in bridge.module.map.incoming}

        def feed(message: Message) -> None:
            kind = ros1_type(type(message))
            try:
                data = kind.to_ros1(message.encode())
            except ConversionError:  # ROS 1 cannot say it
                return
            bridge.module._take(known[message.type_name], kind, data, 0.0)

        yield bridge, feed


@contextmanager
def ros2(accept: dict[str, str]) -> Iterator[tuple[ModuleHarness[Any], Feed]]:
    with ModuleHarness(Ros2Bridge, {"connect": [], "accept": accept}) as bridge:
        channels = {one[1].type_name: channel for channel, one in bridge.module._incoming.items()}

        def feed(message: Message) -> None:
            bridge.module.inbox.put(channels[message.type_name], message.encode(), time.time_ns())
            bridge.advance(0.02)

        yield bridge, feed


@contextmanager
def foxglove(accept: dict[str, str]) -> Iterator[tuple[ModuleHarness[Any], Feed]]:
    with ModuleHarness(FoxgloveServer, {"port": 0, "accept": accept}) as bridge:
        names = {text.split()[0]: name for name, text in accept.items()}

        def feed(message: Message) -> None:
            channel = ClientChannel(names[message.type_name], message.type_name, CDR)
            bridge.module._publish(FromClient(channel, message.encode(), 0, 0.0))

        yield bridge, feed


@contextmanager
def link(_accept: dict[str, str]) -> Iterator[tuple[ModuleHarness[Any], Feed]]:
    settings = {
        "robot": "blue",
        "listen": [],
        "robots": ["red"],
        "accept": {"red": ["*"]},
        "send": {"reliable": ["*"]},
    }
    with ModuleHarness(Link, settings) as bridge:

        def feed(message: Message) -> None:
            name = ChannelId(message.type_name, message.version, "t")
            data = message.encode()
            for traffic in (TrafficClass.RELIABLE, TrafficClass.COMMAND):
                bridge.module.on_arrived(Arrived("red", 1, traffic, 0, name, data, 0, 0, False))

        yield bridge, feed


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("bridge", [ros1, ros2, foxglove, link], ids=lambda one: one.__name__)
def test_bridge_survives_every_damaged_field(bridge: Any, capsys: pytest.CaptureFixture[str]) -> None:
    made, refused = Counter[str](), Counter[tuple[str, str]]()
    deaths: dict[str, str] = {}
    logging.disable(logging.CRITICAL)
    try:
        items = list(ACCEPT.items())
        for begin in range(0, len(items), PART):
            with bridge(dict(items[begin : begin + PART])) as (harness, feed_in):
                for message_type in STOCK[begin : begin + PART]:
                    for what, message in damaged(plausible(message_type)):
                        made[message_type.type_name] += 1
                        for way, feed in (("in", feed_in), ("out", outward(harness))):
                            death = _death_of(feed, message)
                            if death:
                                deaths[f"{message_type.__name__} {what} {way}"] = death
                    _forget_published(harness.bus)
                refused += harness.module.ill_formed.by_kind
    finally:
        logging.disable(logging.NOTSET)
    with capsys.disabled():
        print(
            f"\n{bridge.__name__}: {len(made)} types, {made.total()} damaged fields, both ways; "
            f"{refused.total()} refused of {len(refused)} kinds, {len(deaths)} deaths"
        )
    assert not deaths, "\n".join(f"{message}: {death}" for message, death in list(deaths.items())[:40])
    assert refused


def _death_of(feed: Feed, message: Message) -> str:
    try:
        with warnings.catch_warnings():  # they end no process
            warnings.simplefilter("ignore")
            feed(message)
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:200]
    return ""


def _forget_published(bus: HarnessBus) -> None:
    bus.published.clear()
    bus.published_encoded.clear()
