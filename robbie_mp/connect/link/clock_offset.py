"""How far the monotonic clock of another robot is ahead of ours, measured over the network, with its limits.

Two robots send each other the times of a packet and of its answer. The request cannot arrive before it is
sent, so the other clock is ahead by at most the time of its arrival there minus that of its departure here.
The answer gives the least in the same way. Both limits hold for any delay, and however unequal the two
directions are (Cristian, *Probabilistic clock synchronization*, Distributed Computing 3, 1989; the four times
are those of NTP, RFC 5905, section 8). Between packets, the clocks drift apart, so the limits widen with time
by the greatest drift, and each packet can only narrow them (Marzullo and Owicki, *Maintaining the time in a
distributed system*, PODC 1983). So packets that had to wait do no harm, and those with the least delay
decide, as in NTP's filter.
"""

import math
from typing import NamedTuple

MAX_DRIFT = 1e-3
"""Seconds per second. NTP changes a clock's rate by at most 500e-6; two clocks may differ by twice that."""

AHEAD_NS = 100_000_000
"""A stamp may lie this far in the future: clocks of devices are estimated, and those of pages rounded."""


class Exchange(NamedTuple):
    """The four times of a packet and of the packet that answers it, in ns; the other robot's by its clock."""

    sent_ns: int
    other_received_ns: int
    other_answered_ns: int
    returned_ns: int

    @property
    def round_trip_ns(self) -> int:
        """The time on the network, in both directions together."""
        return (self.returned_ns - self.sent_ns) - (self.other_answered_ns - self.other_received_ns)


class Offset(NamedTuple):
    """The offset of the other clock: that clock minus ours.

    Attributes:
        offset_ns: the middle between the limits.
        uncertainty_ns: the true offset differs from it by no more.
    """

    offset_ns: int
    uncertainty_ns: int


class ClockOffset:
    """Estimates the offset of one other robot's monotonic clock.

    The limits hold as long as neither clock jumps and their rates differ by at most `max_drift`. A jump is
    noticed with the next exchange, unless it is smaller than the limits are apart; then it is noticed later
    or never.

    Args:
        max_drift: greatest difference between the rates of the two clocks, s/s.

    Attributes:
        round_trip_ns: time on the network of the last exchange that was used; None before the first.
    """

    def __init__(self, max_drift: float = MAX_DRIFT):
        if not 0.0 <= max_drift < 1.0:
            raise ValueError(f"max_drift must be at least 0 and less than 1, got {max_drift!r}")
        self._max_drift = max_drift
        self._limits: tuple[int, int] | None = None
        self._at_ns = 0
        self.round_trip_ns: int | None = None

    def add(self, exchange: Exchange) -> bool:
        """Use an exchange. Add exchanges in the order in which they returned.

        Args:
            exchange: its times. Only the caller knows whether it has sent this request.

        Returns:
            Whether it agrees with those before. If not, its times contradict each other, and it is not used,
            or a clock jumped, as when the other robot restarted, and those before are forgotten.
        """
        duration_ns = exchange.returned_ns - exchange.sent_ns
        there_ns = exchange.other_answered_ns - exchange.other_received_ns
        widening_ns = self._widening_ns(duration_ns)
        if duration_ns < 0 or there_ns < 0 or there_ns > duration_ns + widening_ns:
            return False
        self.round_trip_ns = max(0, exchange.round_trip_ns)
        least = exchange.other_answered_ns - exchange.returned_ns - widening_ns
        greatest = exchange.other_received_ns - exchange.sent_ns + widening_ns
        before = self._limits_at(exchange.returned_ns)
        agrees = before is None or (least <= before[1] and greatest >= before[0])
        if before is not None and agrees:
            least, greatest = max(least, before[0]), min(greatest, before[1])
        self._limits, self._at_ns = (least, greatest), max(exchange.returned_ns, self._at_ns)
        return agrees

    def forget(self) -> None:
        """Forget all exchanges, as when the other robot says that it is another session."""
        self._limits = None
        self.round_trip_ns = None

    def at(self, now_ns: int) -> Offset | None:
        """Return the offset; None before the first exchange.

        Args:
            now_ns: our monotonic clock; not before the last exchange.
        """
        limits = self._limits_at(now_ns)
        if limits is None:
            return None
        least, greatest = limits
        middle = (least + greatest) // 2
        return Offset(middle, greatest - middle)

    def age_ns(self, other_stamp_ns: int, now_ns: int) -> tuple[int, int] | None:
        """Return the least and the greatest age that something from the other robot has; None if not known.

        It is not known before the first exchange, nor for a stamp in the future: then one of the clocks has
        jumped, and until the next exchange, what is stale would look new.

        Args:
            other_stamp_ns: when it was made, by the other robot's clock.
            now_ns: our monotonic clock.

        Returns:
            Ages in ns, not less than 0. What must not be late is late if its greatest age is too great.
        """
        limits = self._limits_at(now_ns)
        if limits is None:
            return None
        least, greatest = (now_ns + limit - other_stamp_ns for limit in limits)
        return None if greatest < -AHEAD_NS else (max(0, least), max(0, greatest))

    def _limits_at(self, now_ns: int) -> tuple[int, int] | None:
        if self._limits is None:
            return None
        least, greatest = self._limits
        widening_ns = self._widening_ns(now_ns - self._at_ns)
        return least - widening_ns, greatest + widening_ns

    def _widening_ns(self, duration_ns: int) -> int:
        """Return by how much the clocks may drift apart; 1 ns more, because clocks tell whole nanoseconds."""
        return math.ceil(max(0, duration_ns) * self._max_drift) + 1 if duration_ns else 0
