"""Compares two logs: the messages of each channel in order, bit for bit."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from robbie_mp.recording.alignment import align
from robbie_mp.recording.differences import Difference, first_difference, without_stamps
from robbie_mp.recording.reader import Log, LogChannel, LoggedMessage
from robbie_mp.recording.selection import select

Digests = list[bytes]


class ComparedChannel(NamedTuple):
    """What channels of two logs must share to be compared; versions may differ."""

    topic: str
    type_name: str
    sender: str


@dataclass(frozen=True)
class ChannelComparison:
    """How a channel differs between two logs, A and B.

    Attributes:
        channel: the channel.
        equal: messages that are the same in both.
        different: messages at the same position in both that are not the same.
        only_in_a: messages without a counterpart in B.
        only_in_b: messages without a counterpart in A.
        first: the first message that differs; None if there is none.
    """

    channel: ComparedChannel
    equal: int
    different: int
    only_in_a: int
    only_in_b: int
    first: Difference | None

    @property
    def is_equal(self) -> bool:
        """Whether both have the same messages in the same order."""
        return not (self.different or self.only_in_a or self.only_in_b)


def compare(
    a: Log,
    b: Log,
    patterns: Sequence[str] = (),
    *,
    ignore_stamps: bool = False,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[ChannelComparison]:
    """Compare two logs.

    The times at which messages were published are not compared, and neither is their order between channels.

    Args:
        a: one log.
        b: the other.
        patterns: patterns for channels, as `select` takes them.
        ignore_stamps: treat the stamps in all headers as equal.
        progress: counts the messages of both logs.
    """
    counts = [sum(log.counts.values()) for log in (a, b)]
    of_a = _digests(a, patterns, ignore_stamps, lambda done: progress(done, sum(counts)))
    of_b = _digests(b, patterns, ignore_stamps, lambda done: progress(counts[0] + done, sum(counts)))
    return [
        _compare(channel, (a, b), (of_a.get(channel, []), of_b.get(channel, [])), ignore_stamps)
        for channel in dict.fromkeys([*of_a, *of_b])
    ]


def _digests(
    log: Log, patterns: Sequence[str], ignore_stamps: bool, progress: Callable[[int], None]
) -> dict[ComparedChannel, Digests]:
    chosen, _ = select(log.channels, patterns)
    plain = {channel: without_stamps(channel) if ignore_stamps else bytes for channel in chosen}
    found: dict[ComparedChannel, Digests] = {_compared(channel): [] for channel in chosen}
    lists = {channel: found[_compared(channel)] for channel in chosen}
    for count, message in enumerate(log.messages(channels=chosen), start=1):
        data = plain[message.channel](message.data)
        lists[message.channel].append(hashlib.blake2b(data, digest_size=16).digest())
        progress(count)
    return found


def _compared(channel: LogChannel) -> ComparedChannel:
    return ComparedChannel(channel.topic, channel.type_name, channel.sender)


def _compare(
    channel: ComparedChannel, logs: tuple[Log, Log], digests: tuple[Digests, Digests], ignore_stamps: bool
) -> ChannelComparison:
    equal = different = only_a = only_b = 0
    first: tuple[int, int] | None = None
    for span in align(*digests):
        a_count, b_count = span.a_to - span.a_from, span.b_to - span.b_from
        paired = min(a_count, b_count)
        if span.is_equal:
            equal += paired
            continue
        if paired and first is None:
            first = (span.a_from, span.b_from)
        different += paired
        only_a += a_count - paired
        only_b += b_count - paired
    found = None
    if first is not None:
        a, b = (_message(log, channel, number) for log, number in zip(logs, first, strict=True))
        found = first_difference(a, b, first[0], ignore_stamps=ignore_stamps)
    return ChannelComparison(channel, equal, different, only_a, only_b, found)


def _message(log: Log, channel: ComparedChannel, number: int) -> LoggedMessage:
    wanted = [one for one in log.channels if _compared(one) == channel]
    for place, message in enumerate(log.messages(channels=wanted)):
        if place == number:
            return message
    raise AssertionError("it was there a moment ago")
