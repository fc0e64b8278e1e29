"""The window follows the network, so that it is used and no long queue stands before it."""

from collections import deque

import pytest

from robbie_mp.connect.link.header import PART_BYTES
from robbie_mp.connect.link.send_window import KEPT_NS, MAX_BYTES, SendWindow
from robbie_mp.connect.link.under_way import Arrival, UnderWay
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
        self.under_way = UnderWay()
        self.now_ns = 10**9
        self.trip_ns = 0
        self._round_trip_ns = round_trip_ns
        self._more = more
        self._free_ns = 0
        self._arrivals: deque[tuple[int, int]] = deque()
        """When the report of each packet comes, and the packet's number."""

    def set_round_trip(self, round_trip_ns: int) -> None:
        """Have packets sent from now on take longer."""
        self._round_trip_ns = round_trip_ns

    def run(self, duration_s: float, bytes_per_s: float) -> float:
        """Send images as far as the window allows; return the rate in bytes/s at which they arrive."""
        offered, arrived = 0, self.under_way.arrived
        end_ns = self.now_ns + round(duration_s * 1e9)
        while self.now_ns < end_ns:
            self.now_ns += STEP_NS
            self._acknowledge()
            if self.now_ns % IMAGE_EVERY_NS < STEP_NS:
                offered = IMAGE_BYTES  # the newest replaces what waits
            while offered > 0 and self.window.has_room(self.under_way.bytes, self.now_ns):
                size = min(offered, self.window.part_bytes(self.under_way.bytes))
                self.window.sent(size, self.now_ns)
                offered -= size
                number = self.under_way.add(self.under_way.number + 1, size, self.now_ns)
                self._free_ns = max(self._free_ns, self.now_ns) + round(size * 1e9 / bytes_per_s)
                self._arrivals.append((self._free_ns + self._round_trip_ns + self._more_ns(), number))
        return (self.under_way.arrived - arrived) / duration_s

    def _more_ns(self) -> int:
        return round(self._more.at(self._free_ns * 1e-9) * 1e9) if self._more else 0

    def _acknowledge(self) -> None:
        while self._arrivals and self._arrivals[0][0] <= self.now_ns:
            _, number = self._arrivals.popleft()
            arrival = self.under_way.report(number, number + 1, self.now_ns)
            self.window.take(arrival, self.now_ns)
            self.trip_ns = arrival.trip_ns


@pytest.mark.parametrize("bytes_per_s", [2.5e6, 625e3])
def test_no_long_queue_stands_after_the_network_has_become_slower(bytes_per_s: float) -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 120e6)
    network.run(3.0, bytes_per_s)
    assert network.trip_ns < 100_000_000
    assert network.run(3.0, bytes_per_s) > 0.85 * bytes_per_s


def test_network_that_becomes_faster_is_used() -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 625e3)
    network.run(2.0, 120e6)
    assert network.run(3.0, 120e6) > 3e6


def test_network_whose_delay_grows_is_used_again_within_seconds() -> None:
    network = SlowNetwork(round_trip_ns=10_000_000)
    network.run(3.0, 2.5e6)
    network.set_round_trip(200_000_000)
    network.run(12.0, 2.5e6)
    assert network.run(3.0, 2.5e6) > 1.5e6


def test_network_whose_delay_varies_is_used_within_seconds() -> None:
    shares = []
    for seed in range(5):
        network = SlowNetwork(round_trip_ns=100_000_000, more=Delay(0.1, 0.1, reorders=False, seed=seed))
        shares.append(network.run(9.0, 2.5e6) / 2.5e6)
    assert sum(shares) / len(shares) > 0.4


def test_no_more_is_under_way_than_zenoh_has_room_for() -> None:
    window = SendWindow()
    window.take(Arrival(100_000, 0, 0, 100_000), 1)
    assert window.limit == MAX_BYTES
    assert window.part_bytes(under_way=1) == PART_BYTES


def test_packets_go_one_by_one_until_several_round_trips_are_measured_again() -> None:
    window, start_ns = SendWindow(), 10**9
    window.take(Arrival(4_000, 10_000_000, 0, 4_000), start_ns)
    assert window.has_room(1_000, start_ns)
    now_ns = start_ns + KEPT_NS
    window.take(Arrival(4_000, 300_000_000, 0, 4_000), now_ns)  # late, and no sign of a longer way
    assert not window.has_room(1_000, now_ns)
    for _ in range(20):
        now_ns += 12_000_000
        window.take(Arrival(4_000, 12_000_000, 0, 4_000), now_ns)
    assert window.has_room(1_000, now_ns)
    window.take(Arrival(100_000, 50_000_000, 20_000, 100_000), now_ns)
    assert window.limit < 2.0e6 * 0.05


def test_packet_that_waited_in_a_queue_says_how_much_the_network_carries() -> None:
    window = SendWindow()
    window.take(Arrival(1_000, 100_000_000, 0, 1_000), 1)
    window.take(Arrival(1_000, 100_000_000, 0, 90_000), 2)
    before = window.limit
    window.take(Arrival(1_000, 200_000_000, before, 90_000), 3)
    assert window.limit == pytest.approx(before / 2, rel=0.01)
