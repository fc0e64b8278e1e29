"""Hostile bytes from ROS 2: each message is counted, and reaches modules only if its type declares it so."""

import math
import time
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robbie_mp import ModuleHarness
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.messages import (
    CancelNavigation,
    DriveCommand,
    Header,
    LaserScan,
    PoseStamped,
    TFMessage,
    Twist,
)
from robbie_mp.messages.stock.registry import stock_registry

Bridge = ModuleHarness[Ros2Bridge]
ACCEPTED = {
    "/scan": "LaserScan",
    "/tf": "TFMessage",
    "/goal": "PoseStamped as NavigateTo",
    "/cmd_vel": "Twist as DriveCommand ros",
}
SETTINGS = {
    "connect": [],
    "accept": ACCEPTED,
    "services": {"/go": "CancelNavigation {client: go} or {client: halt}"},
    "emergency_stop": "release",
}
WHOLE = [
    LaserScan(header=Header(frame_id="laser")).encode(),
    TFMessage().encode(),
    PoseStamped().encode(),
    Twist().encode(),
]
BYTES = st.one_of(
    st.binary(max_size=200),
    st.binary(max_size=100).map(lambda data: b"\x00\x01\x00\x00" + data),
    st.tuples(st.sampled_from(WHOLE), st.integers(0, 400), st.binary(max_size=8)).map(
        lambda parts: parts[0][: parts[1]] + parts[2] + parts[0][parts[1] + len(parts[2]) :]
    ),
)


@pytest.fixture(scope="module")
def bridge() -> Iterator[Bridge]:
    """A bridge that nobody can reach, because the tests put bytes into its inbox."""
    with ModuleHarness(Ros2Bridge, SETTINGS) as harness:
        harness.advance(0.02)
        yield harness


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(ACCEPTED)), data=BYTES)
def test_each_message_is_published_or_counted(bridge: Bridge, name: str, data: bytes) -> None:
    module = bridge.module
    (channel,) = [one for one in module._incoming if one.name == name]
    before = module.received + module.malformed + module.refused + module.late
    bridge.bus.published.clear()
    bridge.published_encoded.clear()
    module.inbox.put(channel, data, time.time_ns())
    bridge.advance(0.02)
    counted = module.received + module.malformed + module.refused + module.late - before
    assert counted in (1, 2)  # a velocity that is late is also one that could not be published
    for one in bridge.published_encoded:
        stock_registry().get(one.type_name).decode(one.data)


@pytest.mark.parametrize(
    ("age_s", "moves"),
    [
        (0.0, True),
        (-0.05, True),
        (0.2, True),
        (0.35, False),
        (3600.0, False),
        (-0.2, False),
        (math.nan, False),
    ],
)
def test_velocity_moves_the_robot_only_if_the_clocks_tell_that_it_is_new(
    bridge: Bridge, age_s: float, moves: bool
) -> None:
    (channel,) = [one for one in bridge.module._incoming if one.name == "/cmd_vel"]
    bridge.take(DriveCommand, "ros")
    sent_ns = 0 if math.isnan(age_s) else time.time_ns() - round(age_s * 1e9)
    bridge.module.inbox.put(channel, Twist().encode(), sent_ns)
    bridge.advance(0.02)
    commands = bridge.take(DriveCommand, "ros")
    assert len(commands) == moves
    assert all(one.valid_for.seconds <= 0.3 - max(0.0, age_s) for one in commands)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(["/go", "/emergency_stop", "/robbie/set_parameters"]), data=BYTES)
def test_each_request_is_handled_or_counted(bridge: Bridge, name: str, data: bytes) -> None:
    desk = bridge.module.desk
    before = desk.handled + desk.malformed
    module_requests = len(bridge.bus.published)
    handled = desk.handled
    bridge.module.inbox.put_call(name, data, lambda _: None)
    bridge.advance(0.02)
    assert desk.handled + desk.malformed == before + 1
    if desk.handled == handled:
        sent = bridge.bus.published[module_requests:]
        assert not [one for one in sent if one.message.type_name == CancelNavigation.type_name]


def test_flood_of_messages_and_requests_is_bounded_and_counted(bridge: Bridge) -> None:
    module = bridge.module
    channel = next(iter(module._incoming))
    limit = module.inbox_messages
    overflowed = module.inbox.overflowed
    for _ in range(limit + 5):
        module.inbox.put(channel, b"", time.time_ns())
    for _ in range(70):
        module.inbox.put_call("/go", b"", lambda _: None)
    assert module.inbox.overflowed == overflowed + 5 + 6
    malformed = module.malformed
    bridge.advance(0.02)
    assert module.malformed == malformed + limit
