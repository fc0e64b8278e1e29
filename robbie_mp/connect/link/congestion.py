"""How much may be under way over a link, so that it is used fully and no queue forms on the way.

The window is the measured bandwidth times the smallest round trip, and a little more. That is the model of
BBR (N. Cardwell et al., "BBR: congestion-based congestion control", ACM Queue 14(5), 2016).
"""

from typing import Protocol

from robbie_mp.connect.link.header import PART_BYTES

QUEUE_S = 0.025
"""The queue that may wait on the way, as time: enough to notice that the link can carry more,"""
MAX_QUEUE_BYTES = 1 << 22
"""and as bytes: Zenoh and the sockets must have room for it, and drop the rest."""
MIN_PART_BYTES = 1_000
PART_S = 0.008
"""A packet takes at most this time on the way, so that a command never waits for long behind one,"""
USUAL_PART_BYTES = 128_000
"""and is no larger than this, because what Zenoh has cannot be taken back when the network becomes slow,"""
FAST_PART_S = 0.001
"""unless it takes less than this time: between two processes, each packet costs more than its bytes."""
START_BYTES = 32_000
KEPT_S = 10.0
"""After this time without a shorter round trip, the link is drained to measure it again."""
LONGER_S = 1.0
"""And also if all round trips have been longer for this time: there is a queue, or another way."""
DRAIN_S = 0.2
PACE = 1.25
"""Maximum rate of sending, as a multiple of the measured bandwidth."""
MEASURED_NS = 500_000_000
"""The bandwidth is the greatest one measured in this time, or in 10 round trips if they take longer."""
GROWTH = 1.25
"""If the measured bandwidth has grown by this factor, the window probably limits it, not the network."""
GROWTH_GAIN = 1.6
"""Then more is sent than was measured, by this factor,"""
GROWTH_TRIPS = 3
"""until it has not grown for this many round trips, as BBR begins,"""
VARIES_NS = 40_000_000
"""if round trips are longer than the shortest by more than this on average. Else it grows quickly anyway."""
MAX_PAUSE_NS = 50_000_000
MIN_PARTS = 4
"""Packets that may be under way however slow the link seems."""
SMOOTHING = 0.125
PATIENCE_NS = 75_000_000
"""A packet is late if its round trip takes this much longer than the shortest one: a queue has formed."""
PATIENT = 2
"""If round trips vary, a packet is late only if its excess over the shortest is this many times the mean."""
LOADED = 0.5
"""Where at least this part of the window was under way, what arrives late says how slow the network is."""
MIN_LATE_NS = 20_000_000
"""Least time in which the rate is measured at which a queue empties."""
ALONE = 0.0
"""The load of a small packet that was sent when nothing watched was under way."""
MAX_WINDOW_BYTES = 1 << 25
"""What may be under way at most, whatever the other link says has arrived."""
LEAST_LIMIT_BYTES = MIN_PARTS * MIN_PART_BYTES
"""The window is never smaller."""
PROBE_BYTES = 2_000
"""Maximum size of the first packet after a late one. It measures the round trip again."""


class Watched(Protocol):
    """What is under way of one class."""

    @property
    def oldest_ns(self) -> int:
        """When the oldest one under way was sent; 0: there is none."""


class SendWindow:
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
        self._grown_to = 0.0
        """The bandwidth when it had last grown, or when it was lowered."""
        self._grown_at_ns = 0
        self._gain = 1.0
        self._next_ns = 0
        """When the next packet may be sent, at an even pace."""
        self._excess_ns = 0.0
        """Mean time by which round trips are longer than the shortest one."""
        self._watched: list[Watched] = []
        self._was_late = False
        self._late_from: tuple[int, int] | None = None
        """When the first of several late packets in a row arrived, and how many bytes had arrived then."""

    def watch(self, under_way: Watched) -> None:
        """From now on, send nothing while something of this is late."""
        self._watched.append(under_way)

    @property
    def part_bytes(self) -> int:
        """How many bytes a packet may have."""
        if not self.bandwidth:
            return START_BYTES // 4
        if self._was_late and self._is_idle:
            return PROBE_BYTES
        usual = min(USUAL_PART_BYTES, int(self.bandwidth * PART_S))
        return max(MIN_PART_BYTES, usual, min(PART_BYTES, int(self.bandwidth * FAST_PART_S)))

    @property
    def limit(self) -> int:
        """How many bytes may be under way."""
        if not self.bandwidth:
            return START_BYTES
        queue = min(int(self.bandwidth * QUEUE_S), MAX_QUEUE_BYTES)
        filled = int(self._gain * self.bandwidth * self._shortest_ns / 1e9) + queue
        return max(MIN_PARTS * self.part_bytes, min(filled, MAX_WINDOW_BYTES))

    @property
    def patience_ns(self) -> int:
        """The round trip after which something is late."""
        return self._shortest_ns + max(PATIENCE_NS, round(PATIENT * self._excess_ns))

    def is_late(self, now_ns: int) -> bool:
        """Whether something is under way for longer than it should be: a queue stands on the way."""
        # A loop, because a generator takes longer, and this is called for each packet.
        for one in self._watched:
            waits_ns = now_ns - one.oldest_ns if one.oldest_ns else 0
            if waits_ns > PATIENCE_NS and self._shortest_ns and waits_ns > self.patience_ns:
                return True
        return False

    @property
    def _is_idle(self) -> bool:
        """Whether nothing watched is under way."""
        for one in self._watched:  # noqa: SIM110 - a loop, as in `is_late`
            if one.oldest_ns:
                return False
        return True

    def has_room(self, now_ns: int, size: int = 0) -> bool:
        """Whether one more packet may be sent.

        Args:
            now_ns: the present time.
            size: of a packet that was cut earlier, and may be larger than one would be cut now.
        """
        if self.is_late(now_ns):
            return False
        if size:
            more = size - self.part_bytes
            if more > 0 and self.under_way + more >= self.limit and not self._is_idle:
                return False
        if now_ns < self._drains_until_ns:
            return self.under_way < 2 * self.part_bytes
        return now_ns >= self._next_ns and (self.under_way < LEAST_LIMIT_BYTES or self.under_way < self.limit)

    def sent(self, size: int, now_ns: int) -> tuple[int, float]:
        """Count a packet as under way; return how many bytes have arrived so far, and its load."""
        is_alone = self._is_idle and size <= 2 * PROBE_BYTES
        self.under_way += size
        if self.bandwidth:
            earliest_ns = now_ns - round(QUEUE_S * 1e9)
            rate = PACE * self._gain * self.bandwidth
            self._next_ns = max(self._next_ns, earliest_ns) + round(size * 1e9 / rate)
            self._next_ns = min(self._next_ns, now_ns + MAX_PAUSE_NS)
        return self.delivered, ALONE if is_alone else self.under_way / self.limit

    def given_up(self, size: int) -> None:
        """Count a packet as no longer under way: it will be sent again, or its receiver is gone."""
        self.under_way = max(0, self.under_way - size)

    def acknowledged(self, size: int) -> None:
        """Count a packet as arrived."""
        self.given_up(size)
        self.delivered += size

    def measure(self, sent_ns: int, delivered_before: int, load: float, now_ns: int) -> None:
        """Measure by a packet that has arrived.

        Args:
            sent_ns: when it was sent.
            delivered_before: how many bytes had arrived by then.
            load: how full the window was then.
            now_ns: when the acknowledgement arrived.
        """
        trip_ns = max(1, now_ns - sent_ns)
        is_late = self._shortest_ns > 0 and trip_ns > self.patience_ns
        self._take_trip(trip_ns, now_ns)
        rate = (self.delivered - delivered_before) * 1e9 / trip_ns
        if is_late:
            self._was_late = True
            self._take_late(trip_ns, rate, load, now_ns)
            return
        self._was_late, self._late_from = False, None
        # Measured only now, because after a fall of the bandwidth no round trip says how much they vary.
        self._excess_ns += SMOOTHING * (trip_ns - self._shortest_ns - self._excess_ns)
        # Where packets queue, the network is the limit, however little this link has to send.
        has_queued = trip_ns > self._shortest_ns + QUEUE_S * 1e9
        if rate > self.bandwidth or load >= 1.0 or has_queued:
            self._take_rate(rate, now_ns)
        self._see_growth(now_ns)

    def _see_growth(self, now_ns: int) -> None:
        """Send faster while the bandwidth grows: over a long way that varies, it would grow slowly."""
        if self.bandwidth >= GROWTH * self._grown_to:
            self._grown_to, self._grown_at_ns = self.bandwidth, now_ns
        self._grown_to = min(self._grown_to, self.bandwidth)
        is_growing = now_ns - self._grown_at_ns < GROWTH_TRIPS * self.round_trip_ns
        self._gain = GROWTH_GAIN if is_growing and self._excess_ns > VARIES_NS else 1.0

    def measure_lost(self, sent_ns: int, delivered_before: int, load: float, now_ns: int) -> None:
        """Measure by a packet that is known to be lost, because a later one has arrived.

        Args: as for `measure`.
        """
        trip_ns = max(1, now_ns - sent_ns)
        if self._shortest_ns > 0 and trip_ns > self.patience_ns and load >= LOADED:
            self._lower((self.delivered - delivered_before) * 1e9 / trip_ns)

    def _lower(self, rate: float) -> None:
        """Forget what was measured before: it is no longer true."""
        if 0.0 < rate < self.bandwidth:
            self._greatest = [0.0, rate]
            self.bandwidth = self._grown_to = rate
            self._gain = 1.0

    def _take_late(self, trip_ns: int, rate: float, load: float, now_ns: int) -> None:
        """Measure by a packet that was late."""
        if load == ALONE:  # there was nothing that it could wait for: the way is longer than it was
            self._shortest_ns, self._shortest_at_ns, self._short_at_ns = trip_ns, now_ns, now_ns
        if load < LOADED:
            self._take_rate(rate, now_ns)
            return
        if self._late_from is None:
            self._late_from = now_ns, self.delivered
        since_ns, delivered = self._late_from
        if now_ns - since_ns >= MIN_LATE_NS:
            # A queue empties as quickly as the network is now.
            self._lower((self.delivered - delivered) * 1e9 / (now_ns - since_ns))

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
