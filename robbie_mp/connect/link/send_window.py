"""How much of one class may be under way in a stream.

The limit is what the network carries while a packet goes and its report returns, and a little more: the model
of BBR (N. Cardwell et al., "BBR: congestion-based congestion control", ACM Queue 14(5), 2016). The kernel
shares the network between streams; this bounds how long packets wait in Zenoh and the socket before they go,
and how long other classes wait behind them where all share one stream.
"""

from robbie_mp.connect.link.header import PART_BYTES
from robbie_mp.connect.link.under_way import Arrival

WAIT_NS = 25_000_000
"""Packets may queue for this time: without a queue, nothing would show that the network carries more."""
WAIT_PART = 0.25
"""Packets may also queue for this share of the shortest round trip, if that is longer."""
GROWTH = 1.25
"""If the rate grows by this factor, the window probably limits it, not the network."""
GROWTH_GAIN = 1.3
"""While the rate grows over a long way that varies, the window is larger by this factor."""
GROWTH_TRIPS = 6
"""The rate has stopped growing when this many of the shortest round trips pass without growth."""
LONG_NS = 40_000_000
"""A way is long if its shortest round trip exceeds this, and varies if the mean excess does."""
SMOOTHING = 0.125
LATE_NS = 60_000_000
"""A packet has waited in a queue if its round trip exceeds the shortest by more than this,"""
LATE = 3
"""and by more than this many times the mean excess."""
PACE = 1.25
"""Packets are sent at this multiple of the measured rate; otherwise the whole window would go at once."""
MAX_PAUSE_NS = 50_000_000
"""Longest time between two packets because of the pace."""
START_BYTES = 32_000
MIN_BYTES = 6_000
MAX_BYTES = 15 * PART_BYTES
"""Zenoh queues 16 batches, and drops what is more."""
PERIOD_NS = 500_000_000
"""The rate is the greatest of this period and the one before it, or of 10 round trips if they take longer."""
KEPT_NS = 10_000_000_000
"""The shortest round trip is valid for this time. Then it is measured again, once nothing is under way."""
PROBING_NS = 200_000_000
"""It is measured for this time, by packets that go one by one, because a single one may be late."""
PROBE_BYTES = 4_000
"""Most bytes of a packet that goes alone."""


class SendWindow:
    """Limits the bytes of a stream that are under way. Times in ns.

    Args:
        pauses: whether packets wait while the round trip is measured again. If not, those that happen to go
            alone measure it.

    Attributes:
        limit: how many bytes may be under way.
    """

    def __init__(self, pauses: bool = True) -> None:
        self._pauses = pauses
        self.limit = START_BYTES
        self._shortest_ns = 0
        """The shortest round trip; 0: none is known."""
        self._stale_ns = 0
        """When it is to be measured again; 0: it has not been measured yet."""
        self._probed: tuple[int, int] | None = None
        """While it is measured: the shortest one so far, and when that ends."""
        self._greatest = [0.0, 0.0]
        """Greatest rates in bytes/ns, of the last period and of the present one."""
        self._period_end_ns = 0
        self._excess_ns = 0.0
        """Mean time by which round trips are longer than the shortest."""
        self._grown = (0.0, 0)
        """The rate when it had last grown, and until when (ns) that counts."""
        self._pace = 0.0
        """The rate in bytes/ns at which packets are sent; 0: at any."""
        self._next_ns = 0
        """When the next packet may be sent."""

    def part_bytes(self, under_way: int) -> int:
        """Return how many bytes the next packet may have, if others are under way."""
        return min(self.limit // 8, PART_BYTES) if under_way else PROBE_BYTES

    def has_room(self, under_way: int, now_ns: int) -> bool:
        """Whether one more packet may be sent."""
        if not under_way:
            return True
        # A pace for what does not fill the window would only delay it.
        is_its_turn = under_way < self.limit // 2 or now_ns >= self._next_ns
        is_stale = self._pauses and 0 < self._stale_ns <= now_ns
        return is_its_turn and under_way < self.limit and not is_stale

    def sent(self, size: int, now_ns: int) -> None:
        """Take note of a packet that is sent, so that the next ones follow at an even pace."""
        if self._pace:
            pause_ns = min(size / self._pace, MAX_PAUSE_NS)  # the pace may be almost none
            self._next_ns = max(self._next_ns, now_ns - WAIT_NS) + round(pause_ns)
            self._next_ns = min(self._next_ns, now_ns + MAX_PAUSE_NS)

    def take(self, arrival: Arrival, now_ns: int) -> None:
        """Measure by what has arrived."""
        trip_ns = max(1, arrival.trip_ns)
        self._take_trip(trip_ns, now_ns, was_alone=not arrival.under_way)
        rate, excess_ns = arrival.bytes_meanwhile / trip_ns, trip_ns - self._shortest_ns
        is_late = excess_ns > max(LATE_NS, LATE * self._excess_ns)
        self._excess_ns += SMOOTHING * (excess_ns - self._excess_ns)
        if is_late:
            # The network is the limit. The greatest rate is too high: several reports came at once.
            self._greatest = [0.0, min(rate, max(self._greatest))]
            self._set_limit(now_ns)
            return
        # What had little under way says only that the network carries as much, not that it carries no more.
        if rate > max(self._greatest) or arrival.under_way >= self.limit // 2:
            self._take_rate(rate, now_ns)

    def _take_trip(self, trip_ns: int, now_ns: int, *, was_alone: bool) -> None:
        if not self._stale_ns or trip_ns <= self._shortest_ns:
            self._shortest_ns, self._stale_ns, self._probed = trip_ns, now_ns + KEPT_NS, None
        elif was_alone and now_ns >= self._stale_ns:
            shortest_ns, end_ns = self._probed or (trip_ns, now_ns + PROBING_NS)
            self._probed = min(shortest_ns, trip_ns), end_ns
            if now_ns >= end_ns:
                self._shortest_ns, self._stale_ns = self._probed[0], now_ns + KEPT_NS
                self._probed = None

    def _take_rate(self, rate: float, now_ns: int) -> None:
        if now_ns >= self._period_end_ns:
            self._period_end_ns = now_ns + max(PERIOD_NS, 10 * self._shortest_ns)
            self._greatest = [self._greatest[1], 0.0]
        self._greatest[1] = max(self._greatest[1], rate)
        if max(self._greatest) >= GROWTH * self._grown[0]:
            self._grown = max(self._greatest), now_ns + GROWTH_TRIPS * self._shortest_ns
        self._set_limit(now_ns)

    def _set_limit(self, now_ns: int) -> None:
        rate = max(self._greatest)
        self._grown = min(self._grown[0], rate), self._grown[1]
        is_growing = now_ns < self._grown[1] and min(self._shortest_ns, self._excess_ns) > LONG_NS
        gain = GROWTH_GAIN if is_growing else 1.0
        self._pace = PACE * gain * rate
        carried = rate * (gain * self._shortest_ns + max(WAIT_NS, WAIT_PART * self._shortest_ns))
        self.limit = max(MIN_BYTES, min(MAX_BYTES, round(carried)))
