"""Compares two logs: the messages of each channel in order, bit for bit, and where the first one differs."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robbie_mp.logs.recording.alignment import align
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage, select
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.messages import Header, Message
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.field_types import FieldType, Items, Nested
from robbie_mp.messages.message import fields_of, nested

Digests = list[bytes]


class ComparedChannel(NamedTuple):
    """The key by which channels of two logs are paired; versions may differ.

    `sender` is None if senders are ignored: then all messages of a type and topic are one channel.
    """

    topic: str
    type_name: str
    sender: str | None


@dataclass(frozen=True)
class ComparisonOptions:
    """Says which messages of two logs are compared, and how.

    Attributes:
        patterns: patterns for the channels to compare, as `select` takes them; none: all channels.
        exclude: patterns for channels to leave out, likewise; none: leave out no channel.
        ignore_stamps: treat the stamps in all headers as equal.
        ignore_sender: compare the messages of a type and topic whichever module sent them.
    """

    patterns: Sequence[str] = ()
    exclude: Sequence[str] = ()
    ignore_stamps: bool = False
    ignore_sender: bool = False

    def choose(self, channels: Iterable[LogChannel]) -> list[LogChannel]:
        """Return the channels of a log that are compared."""
        chosen, _ = select(channels, self.patterns)
        left_out = {channel.id for channel in select(chosen, self.exclude)[0]} if self.exclude else set()
        return [channel for channel in chosen if channel.id not in left_out]

    def compared(self, channel: LogChannel) -> ComparedChannel:
        """Return the channel under which the messages of a log's channel are compared."""
        sender = None if self.ignore_sender else channel.sender
        return ComparedChannel(channel.topic, channel.type_name, sender)


COMPARE_ALL = ComparisonOptions()


@dataclass(frozen=True)
class Difference:
    """The first difference between two messages.

    Attributes:
        index: index of the message in its channel of log A, from 0.
        time_ns: when it was published in log A.
        field: its path, such as `pose.position.x` or `ranges[3]`; "" if no field differs.
        a: the value in A; without a field, where the bytes differ.
        b: the value in B.
    """

    index: int
    time_ns: int
    field: str
    a: str
    b: str


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
    options: ComparisonOptions = COMPARE_ALL,
    progress: Progress = unwatched,
) -> list[ChannelComparison]:
    """Compare two logs.

    The times at which messages were published are not compared, and neither is their order between channels.

    Args:
        a: one log.
        b: the other.
        options: what to compare.
        progress: counts the messages of both logs.
    """
    counts = [sum(log.counts.values()) for log in (a, b)]
    of_a = _digests(a, options, lambda done: progress(done, sum(counts)))
    of_b = _digests(b, options, lambda done: progress(counts[0] + done, sum(counts)))
    return [
        _compare(channel, (a, b), (of_a.get(channel, []), of_b.get(channel, [])), options)
        for channel in dict.fromkeys([*of_a, *of_b])
    ]


def _digests(
    log: Log, options: ComparisonOptions, progress: Callable[[int], None]
) -> dict[ComparedChannel, Digests]:
    chosen = options.choose(log.channels)
    plain = {channel: without_stamps(channel) if options.ignore_stamps else bytes for channel in chosen}
    found: dict[ComparedChannel, Digests] = {options.compared(channel): [] for channel in chosen}
    lists = {channel: found[options.compared(channel)] for channel in chosen}
    for count, message in enumerate(log.messages(channels=chosen), start=1):
        data = plain[message.channel](message.data)
        lists[message.channel].append(hashlib.blake2b(data, digest_size=16).digest())
        progress(count)
    return found


def _compare(
    channel: ComparedChannel,
    logs: tuple[Log, Log],
    digests: tuple[Digests, Digests],
    options: ComparisonOptions,
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
        a, b = (_message(log, channel, options, number) for log, number in zip(logs, first, strict=True))
        found = first_difference(a, b, first[0], ignore_stamps=options.ignore_stamps)
    return ChannelComparison(channel, equal, different, only_a, only_b, found)


def _message(log: Log, channel: ComparedChannel, options: ComparisonOptions, number: int) -> LoggedMessage:
    wanted = [one for one in log.channels if options.compared(one) == channel]
    for place, message in enumerate(log.messages(channels=wanted)):
        if place == number:
            return message
    raise AssertionError("it was there a moment ago")


def first_difference(a: LoggedMessage, b: LoggedMessage, index: int, *, ignore_stamps: bool) -> Difference:
    """Return where two messages differ; they must not be equal."""
    found = next(_differing_fields(a, b, ignore_stamps), None)
    if found is None:
        place = next(
            (at for at, pair in enumerate(zip(a.data, b.data, strict=False)) if pair[0] != pair[1]), None
        )
        place = min(len(a.data), len(b.data)) if place is None else place
        found = ("", f"byte {place} of {len(a.data)}", f"byte {place} of {len(b.data)}")
    return Difference(index, a.time_ns, *found)


def _differing_fields(
    a: LoggedMessage, b: LoggedMessage, ignore_stamps: bool
) -> Iterator[tuple[str, str, str]]:
    try:
        decoded_a, decoded_b = (logged_type(one.channel).decode(one.data) for one in (a, b))
    except (MessageError, NotDecodable):
        return
    yield from _of_messages(decoded_a, decoded_b, "", ignore_stamps)


def _of_messages(a: Message, b: Message, path: str, ignore_stamps: bool) -> Iterator[tuple[str, str, str]]:
    names = [field.name for field in fields_of(type(a))]
    others = [field.name for field in fields_of(type(b))]
    if names != others:
        yield path, f"fields {', '.join(names)}", f"fields {', '.join(others)}"
        return
    for name in names:
        if ignore_stamps and name == "stamp" and type(a).type_name == Header.type_name:
            continue
        inner = f"{path}.{name}" if path else name
        yield from _of_values(getattr(a, name), getattr(b, name), inner, ignore_stamps)


def _of_values(a: Any, b: Any, path: str, ignore_stamps: bool) -> Iterator[tuple[str, str, str]]:
    if isinstance(a, Message) and isinstance(b, Message):
        yield from _of_messages(a, b, path, ignore_stamps)
    elif isinstance(a, list | np.ndarray) and isinstance(b, list | np.ndarray):
        if len(a) != len(b):
            yield path, f"{len(a)} elements", f"{len(b)} elements"
            return
        is_numeric = isinstance(a, np.ndarray) and isinstance(b, np.ndarray)
        for place in np.flatnonzero(a != b).tolist() if is_numeric else range(len(a)):
            yield from _of_values(a[place], b[place], f"{path}[{place}]", ignore_stamps)
    elif (text := _text(a)) != _text(b):  # as text, because not-a-number equals itself there
        yield path, text, _text(b)


def _text(value: Any) -> str:
    return repr(value.item() if isinstance(value, np.generic) else value)


def without_stamps(channel: LogChannel) -> Callable[[bytes], bytes]:
    """Return a function that makes messages equal if they differ only in the stamps of their headers."""
    try:
        written = logged_type(channel)
    except (MessageError, NotDecodable):
        return bytes
    if not _has_header(nested(written)):
        return bytes

    def plain(data: bytes) -> bytes:
        try:
            return _unstamped(written.decode(data)).encode()
        except MessageError:
            return data

    return plain


def _has_header(kind: FieldType) -> bool:
    kind = kind.element if isinstance(kind, Items) else kind
    return isinstance(kind, Nested) and (
        kind.message.type_name == Header.type_name
        or any(_has_header(field.type) for field in fields_of(kind.message))
    )


def _unstamped(message: Message) -> Message:
    kind = type(message)
    values = {field.name: getattr(message, field.name) for field in fields_of(kind)}
    if kind.type_name == Header.type_name and "stamp" in values:
        values["stamp"] = type(values["stamp"])()
    for field in fields_of(kind):
        if _has_header(field.type):
            value = values[field.name]
            values[field.name] = [*map(_unstamped, value)] if isinstance(value, list) else _unstamped(value)
    return kind(**values)
