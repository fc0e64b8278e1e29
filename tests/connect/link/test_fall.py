"""The bandwidth of the network falls while images fill it: what is urgent must not wait long behind them."""

import random
from typing import NamedTuple

import pytest

from robbie_mp.connect.link.header import ChannelId, DataHeader
from robbie_mp.connect.link.traffic import TrafficClass
from tests.connect.link._support.network import MS, Conditions, two_robots

STATE = ChannelId("nav_msgs/msg/Odometry", 1, "odom")
BULK = ChannelId("sensor_msgs/msg/Image", 1, "camera")
STOP = ChannelId("robbie_msgs/msg/EmergencyStop", 1, "emergency_stop")
EVENTS = ChannelId("std_msgs/msg/String", 1, "events")
SLOW = 625e3
"""Bytes/s."""
STEP_S = 0.01
STEPS_BETWEEN = 10
"""Every 100 ms, a stop and a state are sent."""


class Wait(NamedTuple):
    """How long a message was under way."""

    sent_s: float
    """From the fall on."""
    wait_s: float


class Fall:
    """Two robots over a network that is fast, and from a moment on slow. Times in s from that moment on.

    Args:
        fast_bytes_per_s: before the fall.
        image_bytes: the size of the images of which one always waits.
    """

    def __init__(self, fast_bytes_per_s: float, image_bytes: int):
        self.conditions = Conditions(delay_ns=5 * MS, bytes_per_s=fast_bytes_per_s)
        self.network, self.red, self.blue = two_robots(1, self.conditions)
        self.image = random.Random(1).randbytes(image_bytes)
        self.run(1.0)
        self.fell_ns = self.network.now_ns
        self.conditions.bytes_per_s = SLOW

    def run(self, duration_s: float) -> None:
        """Send images as fast as the link takes them, and stops and states."""
        assert self.red.node is not None
        bulk = self.red.node.peers["blue"].streams[TrafficClass.BULK]
        for step in range(round(duration_s / STEP_S)):
            if not bulk.waiting:
                self.red.offer(BULK, TrafficClass.BULK, self.image)
            if step % STEPS_BETWEEN == 0:
                self.red.offer(STOP, TrafficClass.URGENT, b"stop")
                self.red.offer(STATE, TrafficClass.STATE, bytes(500))
            self.network.run(STEP_S)

    @property
    def bandwidth(self) -> float:
        """What has lately arrived, in bytes/s."""
        assert self.red.node is not None
        return self.red.node.peers["blue"].bytes_per_s

    def waits(self, name: ChannelId) -> list[Wait]:
        """How long the messages of a channel were under way that were sent after the fall."""
        return [
            Wait((message.stamp_ns - self.fell_ns) / 1e9, (at_ns - message.stamp_ns) / 1e9)
            for at_ns, message in self.blue.journal
            if message.name == name and message.stamp_ns >= self.fell_ns
        ]


def longest(waits: list[Wait], from_s: float, until_s: float) -> float:
    """The longest wait of what was sent in a time."""
    return max(wait_s for sent_s, wait_s in waits if from_s <= sent_s < until_s)


@pytest.mark.parametrize("fast_bytes_per_s", [20e6, 100e6])
def test_what_is_urgent_waits_for_no_more_than_the_networks_queue_after_a_fall(
    fast_bytes_per_s: float,
) -> None:
    fall = Fall(fast_bytes_per_s, image_bytes=900_000)
    fall.run(8.0)
    # The queue of the network holds 1.7 s of images at the new bandwidth; nobody can take them back.
    queue_s = fall.conditions.queue_bytes / SLOW
    for name in (STOP, STATE):
        assert longest(fall.waits(name), 0.0, 4.0) < queue_s + 0.25
    assert len(fall.waits(STOP)) == 80
    # A queue that lost images before the fall makes the link send large packets again, one by one.
    assert longest(fall.waits(STOP), 4.0, 7.5) < (0.2 if fast_bytes_per_s == 20e6 else 0.8)
    assert 0.5 * SLOW < fall.bandwidth < 2.0 * SLOW


def test_a_network_that_is_fast_again_is_used_again() -> None:
    fall = Fall(20e6, image_bytes=900_000)
    fall.run(3.0)
    assert fall.bandwidth < 2.0 * SLOW
    fall.conditions.bytes_per_s = 20e6
    fall.run(3.0)
    assert fall.bandwidth > 10e6


@pytest.mark.parametrize("seed", [8, 19])
def test_link_goes_on_whatever_of_its_stream_was_lost(seed: int) -> None:
    choose = random.Random(seed)
    conditions = Conditions(5 * MS, bytes_per_s=5e6, queue_bytes=choose.choice([60_000, 200_000, 1 << 20]))
    network, red, blue = two_robots(seed, conditions)
    image = random.Random(1).randbytes(150_000)
    for number in range(60):
        if choose.random() < 0.3:
            conditions.loss = choose.choice([0, 0, 0.3, 0.9])
        if choose.random() < 0.3:
            conditions.bytes_per_s = choose.choice([5e6, 300e3, 20e6])
        red.offer(BULK, TrafficClass.BULK, image)
        red.offer(EVENTS, TrafficClass.RELIABLE, bytes([number]) * choose.choice([10, 30_000]))
        network.run(0.03)
    conditions.loss, conditions.bytes_per_s = 0.0, 5e6
    network.run(15.0)
    assert [data[0] for data in blue.received(EVENTS)] == list(range(60))
    assert red.account(EVENTS).under_way == red.account(BULK).under_way == 0


def test_what_is_urgent_is_repeated_less_often_while_nothing_is_acknowledged() -> None:
    network, red, blue = two_robots(1)
    network.conditions.delay_ns = 2000 * MS
    red.offer(STOP, TrafficClass.URGENT, b"stop")
    network.run(6.0)
    assert blue.received(STOP) == [b"stop"]
    copies = [one for one in network.carried if isinstance(one[2], DataHeader) and one[2].traffic == 0]
    # Both ways within a round trip of 4 s, in which the link is thought to be down for a while.
    assert 2 * 5 < len(copies) < 2 * 25
