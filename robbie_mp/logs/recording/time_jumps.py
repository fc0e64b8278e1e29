"""Finds where the time of a log jumps: the robot had no clock battery, its clock was set, it paused long."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from robbie_mp.base.utc import time_text
from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage

LONGEST_GAP_S = 600.0
"""Between two messages; more is a jump, forwards or backwards."""


class LogTimeJump(NamedTuple):
    """Two consecutive messages of a log that are far apart: their log times."""

    before_ns: int
    after_ns: int

    def __str__(self) -> str:
        """Say from when to when."""
        before, after = time_text(self.before_ns / 1e9), time_text(self.after_ns / 1e9)
        seconds = (self.after_ns - self.before_ns) / 1e9
        return f"{before} to {after} ({abs(seconds):.3f} s {'forwards' if seconds > 0 else 'backwards'})"


def time_jumps(log: Log, longest_gap_s: float = LONGEST_GAP_S) -> Iterator[LogTimeJump]:
    """Yield the jumps of a log, in file order. This reads only messages of chunks that span as much.

    Args:
        log: the log.
        longest_gap_s: what is not a jump.
    """
    for one in messages_and_jumps(log, [], round(longest_gap_s * 1e9)):
        if isinstance(one, LogTimeJump):
            yield one


def messages_and_jumps(
    log: Log,
    channels: Iterable[LogChannel],
    longest_gap_ns: int,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[LoggedMessage | LogTimeJump]:
    """Yield the messages of some channels, and between them the jumps of the whole log.

    A pause of these channels is no jump while other channels go on.

    Args:
        log: the log.
        channels: the channels.
        longest_gap_ns: what is not a jump.
        start_ns: leave out messages before this time; the first jump may start there.
        end_ns: leave out messages of this time or later.
    """
    before_ns = start_ns
    for first_ns, last_ns, messages in log.stretches(longest_gap_ns, start_ns, end_ns, channels):
        if before_ns is not None and abs(first_ns - before_ns) > longest_gap_ns:
            yield LogTimeJump(before_ns, first_ns)
        before_ns = last_ns
        yield from messages
