"""The part of a log that is played, and how far that has come."""

from collections.abc import Iterator, Sequence

from robbie_mp.recording.reader import Log, LogChannel, LoggedMessage


class Tape:
    """Messages of some channels from a stretch of a log's time, in file order.

    Args:
        log: the open log.
        channels: whose messages are played.
        begin_ns: time of the log at which the stretch begins.
        end_ns: the last moment of it.

    Attributes:
        next: the next message; None behind the last one.
        sought_ns: where it was set to last.
        taken: messages taken since then.
    """

    def __init__(self, log: Log, channels: Sequence[LogChannel], begin_ns: int, end_ns: int):
        self._log = log
        self._channels = channels
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.seek(begin_ns)

    def seek(self, to_ns: int) -> None:
        """Go to the first message that was not published before a moment."""
        self.sought_ns = to_ns
        self.taken = 0
        self._messages: Iterator[LoggedMessage] = self._log.messages(to_ns, self.end_ns + 1, self._channels)
        self.next = next(self._messages, None)

    def take(self) -> None:
        """Be done with the next message."""
        self.taken += 1
        self.next = next(self._messages, None)

    def restore(self, sought_ns: int, taken: int) -> None:
        """Go to where another tape of the same log was; all that it had taken is read again."""
        self.seek(sought_ns)
        while self.taken < taken and self.next is not None:
            self.take()
