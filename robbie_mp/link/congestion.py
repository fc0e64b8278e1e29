"""How much may be under way over a link, so that it is used fully and no queue forms on the way.

The window is the measured bandwidth times the smallest round trip, and a little more. That is the model of
BBR (N. Cardwell et al., "BBR: congestion-based congestion control", ACM Queue 14(5), 2016).
"""

from robbie_mp.link.header import PART_BYTES

QUEUE_S = 0.025
"""The queue that may wait on the way, as time: enough to notice that the link can carry more."""
MIN_PART_BYTES = 1_000
PART_S = 0.008
"""A packet takes at most this time on the way, so that a command never waits for long behind one."""
START_BYTES = 32_000
KEPT_S = 10.0
"""After this time without a shorter round trip, the link is drained to measure it again."""
LONGER_S = 1.0
"""And also if all round trips have been longer for this time: there is a queue, or another way."""
DRAIN_S = 0.2
PACE = 1.25
"""Packets are sent at most so much faster than the link can carry them."""
MEASURED_NS = 500_000_000
"""The bandwidth is the greatest one measured in this time, or in 10 round trips if they take longer."""
MAX_PAUSE_NS = 50_000_000
MIN_PARTS = 4
"""Packets that may be under way however slow the link seems."""
SMOOTHING = 0.125


class Window:
    """Measures bandwidth and round trip of a link, and limits what is under way. All times in ns.

    Attributes:
        under_way: bytes sent and not acknowledged.
        delivered: bytes acknowledged so far.
        bandwidth: measured, in bytes/s; 0 before the first measurement.
        round_trip_ns: smoothed; 0 before the first measurement.
    """

    def __init__(self) -> None:
        self.under_way = 0
        self.delivered = 0
        self.bandwidth = 0.0
        self.round_trip_ns = 0
        self._shortest_ns = 0
        self._shortest_at_ns = 0
        self._short_at_ns = 0
        """When a round trip was last about as short as the shortest."""
        self._drains_until_ns = 0
        self._greatest = [0.0, 0.0]
        """Greatest bandwidth measured in the last period, and in the present one."""
        self._period_end_ns = 0
        self._next_ns = 0
        """When the next packet may be sent, at an even pace."""

    @property
    def part_bytes(self) -> int:
        """How many bytes a packet may have."""
        if not self.bandwidth:
            return START_BYTES // 4
        return max(MIN_PART_BYTES, min(PART_BYTES, int(self.bandwidth * PART_S)))

    @property
    def limit(self) -> int:
        """How many bytes may be under way."""
        if not self.bandwidth:
            return START_BYTES
        return max(MIN_PARTS * self.part_bytes, int(self.bandwidth * (self._shortest_ns / 1e9 + QUEUE_S)))

    def has_room(self, now_ns: int) -> bool:
        """Whether one more packet may be sent."""
        if now_ns < self._drains_until_ns:
            return self.under_way < 2 * self.part_bytes
        return self.under_way < self.limit and now_ns >= self._next_ns

    def sent(self, size: int, now_ns: int) -> int:
        """Count a packet as under way; return what `acknowledged` needs."""
        self.under_way += size
        if self.bandwidth:
            earliest_ns = now_ns - round(QUEUE_S * 1e9)
            self._next_ns = max(self._next_ns, earliest_ns) + round(size * 1e9 / (PACE * self.bandwidth))
            self._next_ns = min(self._next_ns, now_ns + MAX_PAUSE_NS)
        return self.delivered

    def given_up(self, size: int) -> None:
        """Count a packet as no longer under way: it will be sent again, or its receiver is gone."""
        self.under_way = max(0, self.under_way - size)

    def acknowledged(self, size: int) -> None:
        """Count a packet as arrived."""
        self.given_up(size)
        self.delivered += size

    def measure(self, sent_ns: int, delivered_before: int, was_full: bool, now_ns: int) -> None:
        """Measure by a packet that has arrived and was sent only once.

        Args:
            sent_ns: when it was sent.
            delivered_before: what `sent` returned.
            was_full: whether more would have been sent if the window had been larger.
            now_ns: when the acknowledgement arrived.
        """
        trip_ns = max(1, now_ns - sent_ns)
        self._take_trip(trip_ns, now_ns)
        rate = (self.delivered - delivered_before) * 1e9 / trip_ns
        # Where packets queue, the network is the limit, however little this link has to send.
        has_queued = trip_ns > self._shortest_ns + QUEUE_S * 1e9
        if rate > self.bandwidth or was_full or has_queued:
            self._take_rate(rate, now_ns)

    def _take_rate(self, rate: float, now_ns: int) -> None:
        if now_ns >= self._period_end_ns:
            self._period_end_ns = now_ns + max(MEASURED_NS, 10 * self._shortest_ns)
            self._greatest = [self._greatest[1], 0.0]
        self._greatest[1] = max(self._greatest[1], rate)
        self.bandwidth = max(self._greatest)

    def _take_trip(self, trip_ns: int, now_ns: int) -> None:
        smoothed = self.round_trip_ns
        self.round_trip_ns = round(smoothed + SMOOTHING * (trip_ns - smoothed)) if smoothed else trip_ns
        if trip_ns <= self._shortest_ns + 2 * QUEUE_S * 1e9:
            self._short_at_ns = now_ns
        is_old = (
            now_ns - self._shortest_at_ns > KEPT_S * 1e9
            or now_ns - self._short_at_ns > LONGER_S * 1e9 + self.round_trip_ns
        )
        if self._drains_until_ns:
            if now_ns >= self._drains_until_ns:
                self._drains_until_ns = 0
        elif is_old and self._shortest_ns:
            self._drains_until_ns = now_ns + round(DRAIN_S * 1e9) + self.round_trip_ns
            self._shortest_ns, self._shortest_at_ns = trip_ns, now_ns
            self._short_at_ns = now_ns
        if not self._shortest_ns or trip_ns <= self._shortest_ns:
            self._shortest_ns, self._shortest_at_ns = trip_ns, now_ns
            self._short_at_ns = now_ns

    def forget_under_way(self) -> None:
        """Begin again: nothing is under way to a new receiver."""
        self.under_way = 0
