"""What is under way: each sending has a number, and the receiver reports the newest one that has arrived.

Older ones then have arrived, too, or never will. So the sender knows how much is under way, and for how long,
however often the same packet was sent.
"""

from collections import deque
from typing import NamedTuple

from robbie_mp.connect.link.congestion import SendWindow

MAX_SENDINGS = 1 << 16
"""Sendings that may be under way; older ones count as lost."""


class Sending(NamedTuple):
    """One sending of one packet. Times in ns."""

    number: int
    sequence: int
    size: int
    sent_ns: int
    delivered_before: int
    """Bytes that had arrived when it was sent."""
    load: float
    """How full the window was then, it included: 1.0 is full."""


class UnderWay:
    """The sendings of one class to one robot.

    Args:
        window: what may be under way, of all classes together.
        is_stream: whether they go in the stream, where all that is sent later waits behind them.

    Attributes:
        number: of the last sending.
        bytes: how much is under way.
        oldest_ns: when the oldest one under way was sent; 0: there is none.
    """

    def __init__(self, window: SendWindow, *, is_stream: bool):
        self._window = window
        self._is_stream = is_stream
        self._sendings: deque[Sending] = deque()
        self.number = 0
        self.bytes = 0
        self.oldest_ns = 0
        if is_stream:
            window.watch(self)

    def add(self, sequence: int, size: int, now_ns: int) -> int:
        """Count a sending; return its number.

        Args:
            sequence: of the packet.
            size: its bytes, header included.
            now_ns: the present time.
        """
        self.number += 1
        self.bytes += size
        delivered, load = self._window.sent(size, now_ns)
        self._sendings.append(Sending(self.number, sequence, size, now_ns, delivered, load))
        if len(self._sendings) > MAX_SENDINGS:
            oldest = self._sendings.popleft()
            self.bytes -= oldest.size
            self._window.given_up(oldest.size)
        self.oldest_ns = self._sendings[0].sent_ns
        return self.number

    def report(self, newest: int, following: int, now_ns: int) -> bool:
        """Take note of a receiver's report. Return whether something has arrived for the first time.

        Args:
            newest: the greatest number of a sending that has arrived.
            following: sequence of the first packet that has not arrived, as in `Report.next`.
            now_ns: when the report came.
        """
        has_arrived = False
        while self._sendings and self._sendings[0].number <= newest:
            sending = self._sendings.popleft()
            self.bytes -= sending.size
            if sending.sequence >= following:  # lost, or dropped by the receiver
                self._window.given_up(sending.size)
                if self._is_stream:
                    self._window.measure_lost(sending.sent_ns, sending.delivered_before, sending.load, now_ns)
                continue
            has_arrived = True
            self._window.acknowledged(sending.size)
            # Of datagrams, an older one may be lost, and a later one has shown that.
            if self._is_stream or sending.number == newest:
                self._window.measure(sending.sent_ns, sending.delivered_before, sending.load, now_ns)
        self.oldest_ns = self._sendings[0].sent_ns if self._sendings else 0
        return has_arrived

    def forget(self) -> None:
        """Count nothing as under way: its receiver is gone."""
        self._window.given_up(self.bytes)
        self.bytes = self.oldest_ns = 0
        self._sendings.clear()
