"""The window follows a network that becomes slower, so that no long queue stands before it."""

from collections import deque

import pytest

from robbie_mp.connect.link.congestion import MAX_QUEUE_BYTES, USUAL_PART_BYTES, SendWindow
from robbie_mp.connect.link.header import PART_BYTES
from tools.test_network.delay import Delay

STEP_NS = 1_000_000
IMAGE_BYTES = 200_000
IMAGE_EVERY_NS = 60_000_000


class SlowNetwork:
    """Carries packets one after the other at a rate that can change, and acknowledges each.

    Args:
        round_trip_ns: of a small packet.
        more: what it takes longer, as it varies over time.
    """

    def __init__(self, round_trip_ns: int, more: Delay | None = None):
        self.window = SendWindow()
        self.window.watch(self)
        self.now_ns = 10**9
        self.trip_ns = 0
        self._round_trip_ns = round_trip_ns
        self._more = more
        self._free_ns = 0
        self._under_way: deque[tuple[int, int, int, float, int]] = deque()

    @property
    def oldest_ns(self) -> int:
        """When the oldest one under way was sent; 0: there is none."""
        return self._under_way[0][1] if self._under_way else 0

    def set_round_trip(self, round_trip_ns: int) -> None:
        """Have packets sent from now on take longer."""
        self._round_trip_ns = round_trip_ns

    def run(self, duration_s: float, bytes_per_s: float) -> None:
        """Send images as far as the window allows; the newest replaces what waits."""
        offered = 0
        end_ns = self.now_ns + round(duration_s * 1e9)
        while self.now_ns < end_ns:
            self.now_ns += STEP_NS
            self._acknowledge()
            if self.now_ns % IMAGE_EVERY_NS < STEP_NS:
                offered = IMAGE_BYTES
            while offered >= self.window.part_bytes and self.window.has_room(self.now_ns):
                size = self.window.part_bytes
                offered -= size
                before, load = self.window.sent(size, self.now_ns)
                self._free_ns = max(self._free_ns, self.now_ns) + round(size * 1e9 / bytes_per_s)
                arrives_ns = self._free_ns + self._round_trip_ns + self._more_ns()
                self._under_way.append((arrives_ns, self.now_ns, before, load, size))

    def _more_ns(self) -> int:
        return round(self._more.at(self._free_ns * 1e-9) * 1e9) if self._more else 0

    def _acknowledge(self) -> None:
        while self._under_way and self._under_way[0][0] <= self.now_ns:
            _, sent_ns, before, load, size = self._under_way.popleft()
            self.window.acknowledged(size)
            self.window.measure(sent_ns, before, load, self.now_ns)
            self.trip_ns = self.now_ns - sent_ns


@pytest.mark.parametrize("bytes_per_s", [2.5e6, 625e3])
def test_no_long_queue_stands_after_the_network_has_become_slower(bytes_per_s: float) -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 120e6)
    network.run(3.0, bytes_per_s)
    assert network.trip_ns < 100_000_000
    assert network.window.bandwidth == pytest.approx(bytes_per_s, rel=0.3)


def test_network_that_becomes_faster_is_used() -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 625e3)
    network.run(5.0, 120e6)
    assert network.window.bandwidth > 3e6


def test_network_whose_delay_grows_is_used_again_within_seconds() -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 2.5e6)
    network.set_round_trip(200_000_000)
    network.run(4.0, 2.5e6)
    assert network.window.bandwidth > 1.5e6
    assert network.window.limit > 200_000


def test_network_whose_delay_varies_is_used_within_seconds() -> None:
    shares = []
    for seed in range(5):
        network = SlowNetwork(round_trip_ns=100_000_000, more=Delay(0.1, 0.1, reorders=False, seed=seed))
        network.run(9.0, 2.5e6)
        shares.append(network.window.delivered / (9.0 * 2.5e6))
    assert sum(shares) / len(shares) > 0.4


@pytest.mark.parametrize(("bytes_per_s", "part_bytes"), [(100e6, USUAL_PART_BYTES), (2e9, PART_BYTES)])
def test_packets_are_larger_only_where_the_network_is_so_fast_that_they_take_no_time(
    bytes_per_s: float, part_bytes: int
) -> None:
    window = SendWindow()
    window.bandwidth = bytes_per_s
    assert window.part_bytes == part_bytes


def test_no_more_waits_on_the_way_than_queues_and_sockets_hold() -> None:
    window = SendWindow()
    window.bandwidth = 2e9
    assert window.limit == MAX_QUEUE_BYTES
