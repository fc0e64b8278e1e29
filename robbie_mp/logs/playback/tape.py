"""The part of a log that is played, and the position in it."""

from collections.abc import Iterator, Sequence
from itertools import chain

from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage
from robbie_mp.logs.recording.time_jumps import LogTimeJump, messages_and_jumps


class Tape:
    """Messages of some channels from a stretch of a log's time, in file order, and the log's jumps between.

    At its beginning, and after each seek, first come the messages of latched channels that were newest then.

    Args:
        log: the open log.
        channels: the channels to play.
        begin_ns: log time at which the stretch starts.
        end_ns: log time of its last moment.
        gap_ns: where the time of the log jumps farther, forwards or backwards, a jump is on the tape; None:
            there are no jumps.

    Attributes:
        next: the next message or jump; None after the last message.
        sought_ns: the target of the last seek.
        taken: messages and jumps taken since then.
        gives: how many of the next messages are from before the position, because their channels are latched.
    """

    def __init__(
        self,
        log: Log,
        channels: Sequence[LogChannel],
        begin_ns: int,
        end_ns: int,
        gap_ns: int | None = None,
    ):
        self._log = log
        self._channels = channels
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self._gap_ns = gap_ns
        self.seek(begin_ns)

    def seek(self, to_ns: int) -> None:
        """Go to the first message published at or after a moment, and to what was newest before it."""
        self.sought_ns = to_ns
        self.taken = 0
        latched = self._log.newest_latched(to_ns, self._channels)
        self.gives = len(latched)
        self._events = chain(latched, self._from(to_ns))
        self.next = next(self._events, None)

    def _from(self, start_ns: int) -> Iterator[LoggedMessage | LogTimeJump]:
        if self._gap_ns is None:
            yield from self._log.messages(start_ns, self.end_ns + 1, self._channels)
            return
        jumps: list[LogTimeJump] = []  # nothing is played after the last message, so no jump either
        for one in messages_and_jumps(self._log, self._channels, self._gap_ns, start_ns, self.end_ns + 1):
            if isinstance(one, LogTimeJump):
                jumps.append(one)
            else:
                yield from jumps
                jumps.clear()
                yield one

    def take(self) -> None:
        """Advance past the next message or jump."""
        self.taken += 1
        self.gives = max(0, self.gives - 1)
        self.next = next(self._events, None)

    def restore(self, sought_ns: int, taken: int) -> None:
        """Go to the position of another tape of the same log. This reads again all that it had taken."""
        self.seek(sought_ns)
        while self.taken < taken and self.next is not None:
            self.take()
