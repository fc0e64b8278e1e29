"""What is under way: each sending has a number, and the receiver reports the newest one that has arrived.

Older ones then have arrived, too, or never will. So the sender knows how much is under way, however often the
same packet was sent.
"""

from collections import deque
from typing import NamedTuple

MAX_SENDINGS = 1 << 16
"""Sendings that may be under way; older ones count as lost."""


class Sending(NamedTuple):
    """One sending of one packet."""

    number: int
    sequence: int
    size: int
    sent_ns: int
    under_way: int
    """Bytes that were under way when it was sent."""
    arrived: int
    """Bytes that had arrived when it was sent."""


class Arrival(NamedTuple):
    """What a report says has arrived for the first time."""

    bytes: int = 0
    """0: nothing."""
    trip_ns: int = 0
    """Round trip of the newest of it."""
    under_way: int = 0
    """Bytes that were under way when the newest was sent."""
    bytes_meanwhile: int = 0
    """Bytes that have arrived since then, it included."""


NOTHING = Arrival()


class UnderWay:
    """The sendings of one class to one robot.

    Attributes:
        number: of the last sending.
        bytes: how much is under way.
        arrived: bytes that have arrived so far.
    """

    def __init__(self) -> None:
        self._sendings: deque[Sending] = deque()
        self.number = 0
        self.bytes = 0
        self.arrived = 0

    def add(self, sequence: int, size: int, now_ns: int) -> int:
        """Count a sending; return its number.

        Args:
            sequence: of the packet.
            size: its bytes, header included.
            now_ns: the present time.
        """
        self.number += 1
        self._sendings.append(Sending(self.number, sequence, size, now_ns, self.bytes, self.arrived))
        self.bytes += size
        if len(self._sendings) > MAX_SENDINGS:
            self.bytes -= self._sendings.popleft().size
        return self.number

    def report(self, newest: int, following: int, now_ns: int) -> Arrival:
        """Take note of a receiver's report, and return what has arrived.

        Args:
            newest: the greatest number of a sending that has arrived.
            following: sequence of the first packet that has not arrived, as in `ReceiverReport.next`.
            now_ns: when the report came.
        """
        last, size = None, 0
        while self._sendings and self._sendings[0].number <= newest:
            sending = self._sendings.popleft()
            self.bytes -= sending.size
            if sending.sequence < following:  # otherwise it is lost, or dropped by the receiver
                size += sending.size
                last = sending
        self.arrived += size
        if last is None:
            return NOTHING
        return Arrival(size, now_ns - last.sent_ns, last.under_way, self.arrived - last.arrived)

    def forget(self) -> None:
        """Count nothing as under way: its receiver is gone."""
        self.bytes = 0
        self._sendings.clear()
