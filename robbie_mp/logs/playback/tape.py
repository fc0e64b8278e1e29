"""The part of a log that is played, and the position in it."""

from collections.abc import Iterator, Sequence
from itertools import chain

from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage


class Tape:
    """Messages of some channels from a stretch of a log's time, in file order.

    At its beginning, and after each seek, first come the messages of latched channels that were newest then.

    Args:
        log: the open log.
        channels: the channels to play.
        begin_ns: log time at which the stretch starts.
        end_ns: log time of its last moment.

    Attributes:
        next: the next message; None after the last one.
        sought_ns: the target of the last seek.
        taken: messages taken since then.
        gives: how many of the next messages are from before the position, because their channels are latched.
    """

    def __init__(self, log: Log, channels: Sequence[LogChannel], begin_ns: int, end_ns: int):
        self._log = log
        self._channels = channels
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.seek(begin_ns)

    def seek(self, to_ns: int) -> None:
        """Go to the first message published at or after a moment, and to what was newest before it."""
        self.sought_ns = to_ns
        self.taken = 0
        latched = self._log.newest_latched(to_ns, self._channels)
        self.gives = len(latched)
        messages = self._log.messages(to_ns, self.end_ns + 1, self._channels)
        self._messages: Iterator[LoggedMessage] = chain(latched, messages)
        self.next = next(self._messages, None)

    def take(self) -> None:
        """Advance past the next message."""
        self.taken += 1
        self.gives = max(0, self.gives - 1)
        self.next = next(self._messages, None)

    def restore(self, sought_ns: int, taken: int) -> None:
        """Go to the position of another tape of the same log. This reads again all messages it had taken."""
        self.seek(sought_ns)
        while self.taken < taken and self.next is not None:
            self.take()
