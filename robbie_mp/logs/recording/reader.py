"""Reads logs: messages in the order in which they were recorded, from one file or a folder of parts.

A channel can be selected by its name. Logs from other programs state no versions; this finds them.
"""

import contextlib
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Schema
from typing_extensions import Self

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.contents import Contents
from robbie_mp.logs.recording.errors import NotALog
from robbie_mp.logs.recording.format import (
    BAG_METADATA,
    BAG_PART_NAME,
    CARRIED_KEY,
    LATCHED_KEY,
    MESSAGE_ENCODING,
    PART_NAME,
    QOS_KEY,
    SCHEMA_ENCODING,
    SENDER_KEY,
    TOPIC_KEY,
    VERSION_KEY,
    ChannelKey,
)
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.part import LogPart, PartMessage
from robbie_mp.logs.recording.scan import LOST_DESCRIPTIONS
from robbie_mp.messages import Message, TFMessage, message_type_from_schema
from robbie_mp.messages.errors import MessageError, SchemaError
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.registry import TypeRegistry, full_name
from robbie_mp.messages.schema import layout
from robbie_mp.messages.service_events import event_schema, is_event_type
from robbie_mp.messages.stock.registry import stock_registry

FIXED_TRANSFORMS = "tf_static"
"""Last part of the topics whose newest messages hold, even in logs that do not mark them as latched."""
TRANSIENT_LOCAL = re.compile(r"\bdurability: *(1|transient_local)\b")
"""In the quality of service of a channel that rosbag2 has recorded: latched."""
NO_CHANNEL = "messages whose channel the file does not describe"
REPAIRED_SUFFIX = ".repaired.mcap"
"""End of the name that `robbie recording repair` gives to the repaired copy of a .mcap file."""


@dataclass(frozen=True)
class LogChannel:
    """The messages of one type and version, on one topic, from one sender.

    Attributes:
        id: its index in `Log.channels`.
        type_name: such as `sensor_msgs/msg/LaserScan`; "" if the log does not say.
        version: version of the type; for a foreign channel see `version_of_foreign`.
        topic: Robbie's topic; in a log from another program, that program's topic without the leading slash.
        sender: the module that published the messages; "" if it is not known.
        schema: the ros2msg text of the type, which is "" for a type without fields; None if the log has none.
        encoding: encoding of the messages: "cdr", unless another program wrote the log.
        is_foreign: whether another program wrote the log; such logs have no versions and senders.
        is_latched: whether a subscriber that comes later gets its newest message.
    """

    id: int
    type_name: str
    version: int
    topic: str
    sender: str
    schema: str | None
    encoding: str = MESSAGE_ENCODING
    is_foreign: bool = False
    is_latched: bool = False

    @property
    def key(self) -> ChannelKey:
        """The key of the channel in the counts of a log."""
        return ChannelKey(self.type_name, self.version, self.topic, self.sender)


class LoggedMessage(NamedTuple):
    """A message of a log.

    Attributes:
        channel: type, topic and sender.
        sequence: its place in the order of the run, modulo 2^32.
        time_ns: when it was published, in ns since the epoch on the run's clock.
        data: its encoding.
    """

    channel: LogChannel
    sequence: int
    time_ns: int
    data: bytes


class Log:
    """An open log; use it as a context manager. `open_log` makes one.

    Attributes:
        path: the file or folder.
        parts: its files, in order.
        channels: the recorded channels.
        start_ns: time of the earliest message; 0 if there is none.
        end_ns: time of the latest message; 0 if there is none.
    """

    def __init__(self, path: Path, parts: list[LogPart]):
        self.path = path
        self.parts = parts
        self.channels: list[LogChannel] = []
        self._stock = stock_registry()
        self._channels_of: list[dict[int, LogChannel]] = []
        """For each part, its channels by their ids in that file."""
        self._carried_of: list[dict[int, LogChannel]] = []
        """Likewise, the channels of which there are copies at the beginning of the part."""
        found = [
            {
                id_: _log_channel(part.contents, channel, self._stock)
                for id_, channel in part.contents.channels.items()
            }
            for part in parts
        ]
        latched = {
            found_in[id_].key[:3]
            for part, found_in in zip(parts, found, strict=True)
            for id_, channel in part.contents.channels.items()
            if _is_latched(channel, found_in[id_])
        }
        known: dict[LogChannel, LogChannel] = {}
        for part, found_in in zip(parts, found, strict=True):
            carried = {id_ for id_, one in part.contents.channels.items() if one.metadata.get(CARRIED_KEY)}
            of_part = {id_: self._channel(one, latched, known) for id_, one in found_in.items()}
            self._channels_of.append({id_: one for id_, one in of_part.items() if id_ not in carried})
            self._carried_of.append({id_: of_part[id_] for id_ in carried})
        filled = [part.contents for part in parts if part.contents.message_count]
        self.start_ns = min((contents.start_ns for contents in filled), default=0)
        self.end_ns = max((contents.end_ns for contents in filled), default=0)

    def _channel(
        self,
        anonymous: LogChannel,
        latched: Container[tuple[str, int, str]],
        known: dict[LogChannel, LogChannel],
    ) -> LogChannel:
        if anonymous not in known:
            is_latched = anonymous.key[:3] in latched
            known[anonymous] = replace(anonymous, id=len(self.channels), is_latched=is_latched)
            self.channels.append(known[anonymous])
        return known[anonymous]

    @property
    def is_complete(self) -> bool:
        """Whether all files were written to their ends, and no damage has been found so far."""
        return all(part.is_complete for part in self.parts)

    @property
    def damage(self) -> list[str]:
        """The damage found so far: one line for each place."""
        return [f"{part.path}: {damage}" for part in self.parts for damage in part.contents.damage]

    def count_damage(self, balance: Balance) -> None:
        """Count the damage found so far: messages of lost channels, and each damaged place as one."""
        balance.leave_out(NO_CHANNEL, sum(part.contents.strangers for part in self.parts))
        for line in self.damage:
            if not line.endswith(LOST_DESCRIPTIONS):
                balance.leave_out(f"what is damaged: {line}")

    @property
    def counts(self) -> dict[LogChannel, int]:
        """Number of messages in each channel, without copies at the beginning of parts."""
        return self._count(self._channels_of)

    @property
    def carried_counts(self) -> dict[LogChannel, int]:
        """Number of copies of messages of each channel, at the beginning of parts."""
        return self._count(self._carried_of)

    def _count(self, channels_of: Sequence[dict[int, LogChannel]]) -> dict[LogChannel, int]:
        counts = dict.fromkeys(self.channels, 0)
        for part, channels in zip(self.parts, channels_of, strict=True):
            for channel_id, count in part.contents.counts.items():
                if channel_id in channels:
                    counts[channels[channel_id]] += count
        return counts

    @property
    def message_count(self) -> int:
        """Number of messages in all channels, without copies at the beginning of parts."""
        return sum(self.counts.values())

    def files(self) -> Iterator[tuple[LogPart, dict[int, LogChannel]]]:
        """Yield each part with its channels, by their ids in that file, without those of copies."""
        return zip(self.parts, self._channels_of, strict=True)

    def record_of(self, channel: LogChannel) -> tuple[LogPart, Channel]:
        """Return a part in which a channel of this log is described, and its record there."""
        for part, of_part, carried in zip(self.parts, self._channels_of, self._carried_of, strict=True):
            for id_, one in (of_part | carried).items():
                if one is channel:
                    return part, part.contents.channels[id_]
        raise KeyError(channel)

    def metadata(self, name: str) -> list[dict[str, str]]:
        """Return the metadata records of that name, in file order."""
        records = (record for part in self.parts for record in part.contents.metadata)
        return [record.metadata for record in records if record.name == name]

    def messages(
        self,
        start_ns: int | None = None,
        end_ns: int | None = None,
        channels: Iterable[LogChannel] | None = None,
    ) -> Iterator[LoggedMessage]:
        """Yield messages in file order, which is the order in which the core routed them.

        Damaged messages are left out; `is_complete` and `damage` report them afterwards. The copies of older
        messages at the beginning of each part are left out too; see `newest_latched`.

        Args:
            start_ns: leave out messages published before this time.
            end_ns: leave out messages published at this time or later.
            channels: yield messages of these channels only.
        """
        for part, known, ids in self._files_with(channels):
            yield from _logged(part.messages(start_ns, end_ns, ids), known)

    def stretches(
        self,
        longest_ns: int,
        start_ns: int | None = None,
        end_ns: int | None = None,
        channels: Iterable[LogChannel] | None = None,
    ) -> Iterator[tuple[int, int, Iterator[LoggedMessage]]]:
        """Yield the same messages by stretches of the log: see `LogPart.stretches`."""
        for part, known, ids in self._files_with(channels):
            for first_ns, last_ns, messages in part.stretches(longest_ns, start_ns, end_ns, ids):
                yield first_ns, last_ns, _logged(messages, known)

    def _files_with(
        self, channels: Iterable[LogChannel] | None
    ) -> Iterator[tuple[LogPart, dict[int, LogChannel], set[int] | None]]:
        """Yield each part with its channels, and the ids there of those that are wanted."""
        wanted = None if channels is None else {channel.id for channel in channels}
        for part, known in self.files():
            yield (
                part,
                known,
                None if wanted is None else {id_ for id_, channel in known.items() if channel.id in wanted},
            )

    def newest_latched(
        self, before_ns: int, channels: Iterable[LogChannel] | None = None
    ) -> list[LoggedMessage]:
        """Return the newest message of each latched topic: what a subscriber that comes at a moment gets.

        The messages at the beginning of each part say what was newest before it. Of `tf_static` you get
        the newest message of each sender, because each may describe other frames.

        Args:
            before_ns: the moment; later messages do not count, nor do those published at that time.
            channels: messages of these channels only.

        Returns:
            The messages, each with the time at which it was published, in the order of these times.
        """
        chosen = set(self.channels if channels is None else channels)
        missing = {_latched_as(channel) for channel in chosen if channel.is_latched}
        found: list[LoggedMessage] = []
        first = next((part for part in self.parts if part.contents.message_count), None)
        files = zip(self.parts, self._channels_of, self._carried_of, strict=True)
        for part, of_part, carried in reversed(list(files)):
            start_ns = part.contents.start_ns
            if part.contents.message_count and (start_ns <= before_ns or part is first):
                carried_until_ns = max(before_ns, start_ns) + 1
                until_ns = dict.fromkeys(of_part, before_ns) | dict.fromkeys(carried, carried_until_ns)
                channels_in = {id_: one for id_, one in (of_part | carried).items() if one in chosen}
                found += _newest_in(part, channels_in, until_ns, missing)
        return sorted(found, key=lambda message: (message.time_ns, message.sequence))

    def close(self) -> None:
        """Close the log's files."""
        for part in self.parts:
            part.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def open_log(path: Path, limits: ReadLimits = READ_LIMITS) -> Log:
    """Open a log: an MCAP file, or a folder of parts `NAME_0000.mcap`, `NAME_0001.mcap`, ….

    A truncated log, or one still being written, is read to its last whole chunk; opening it reads all of it.

    Args:
        path: the file or folder.
        limits: limits for its contents.

    Raises:
        LogUnreadable: the log is missing, or you may not read it.
        NotALog: it is not a log, or is a folder that holds no log or several.
        LogLimitExceeded: something in the log is too large; reading its messages can also raise this.
    """
    with ExitStack() as opened:
        parts = [opened.enter_context(LogPart(file, limits)) for file in part_files(path)]
        log = Log(path, parts)
        opened.pop_all()
    return log


def channel_name(channel: LogChannel) -> str:
    """Return the name of a channel: its topic, or without one the last part of its type."""
    return channel.topic or channel.type_name.rpartition("/")[2]


def select(channels: Iterable[LogChannel], patterns: Sequence[str]) -> tuple[list[LogChannel], list[str]]:
    """Choose channels by shell patterns of their names.

    Args:
        channels: the channels to choose from.
        patterns: such as `laser/*` or `Odometry`; a leading slash is ignored. Without patterns: all channels.

    Returns:
        The channels, and the patterns that match no channel.
    """
    every = list(channels)
    if not patterns:
        return every, []
    names = {channel.id: channel_name(channel) for channel in every}
    matches = {
        pattern: {id_ for id_, name in names.items() if fnmatchcase(name, pattern.removeprefix("/"))}
        for pattern in patterns
    }
    chosen = set().union(*matches.values())
    unmatched = [pattern for pattern, ids in matches.items() if not ids]
    return [channel for channel in every if channel.id in chosen], unmatched


def part_files(path: Path) -> list[Path]:
    """Return the files of a log, in order; of a repaired part, only the repaired file.

    Empty files are left out if there are others: a logger was killed just when it began such a part. rosbag2
    numbers the parts of a bag without leading zeros.

    Raises:
        NotALog: it is a folder that holds no log or several.
    """
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.mcap"), key=_is_repaired)
    found = [file for file in found if file.stat().st_size] or found
    files = {_original_stem(file): file for file in found}
    pattern = BAG_PART_NAME if _is_bag(path, files) else PART_NAME
    parts = {stem: pattern.fullmatch(f"{stem}.mcap") for stem in files}
    names = {match["name"] if match else stem for stem, match in parts.items()}
    if not names:
        raise NotALog(f"the folder {path} has no parts of a log (files NAME_0000.mcap, NAME_0001.mcap, …)")
    if len(names) > 1:
        raise NotALog(f"the folder {path} has several logs ({', '.join(sorted(names))}); name a file")
    numbers = {stem: int(match["number"]) if match else -1 for stem, match in parts.items()}
    return [files[stem] for stem in sorted(files, key=numbers.__getitem__)]


def _is_bag(folder: Path, stems: Iterable[str]) -> bool:
    """Whether rosbag2 has named the files; other files with short numbers may be logs of their own."""
    names = {f"{folder.resolve().name}_{stem.rpartition('_')[2]}" for stem in stems}
    return (folder / BAG_METADATA).exists() or names == set(stems) or any(one.endswith("_0") for one in stems)


def _is_repaired(file: Path) -> bool:
    return file.name.endswith(REPAIRED_SUFFIX)


def _original_stem(file: Path) -> str:
    return file.name.removesuffix(REPAIRED_SUFFIX).removesuffix(".mcap")


def _log_channel(contents: Contents, channel: Channel, stock: TypeRegistry) -> LogChannel:
    """Describe a channel, without its id for now."""
    schema = contents.schemas.get(channel.schema_id)
    type_name = full_name(schema.name) if schema else ""
    text = _schema_text(schema, stock) if schema else None
    about = channel.metadata
    version = about.get(VERSION_KEY, "")
    is_ours = version.isdecimal()
    return LogChannel(
        id=-1,
        type_name=type_name,
        version=int(version) if is_ours else _foreign_version(type_name, text, stock),
        topic=about.get(TOPIC_KEY, channel.topic.removeprefix("/")),
        sender=about.get(SENDER_KEY, ""),
        schema=text,
        encoding=channel.message_encoding,
        is_foreign=not is_ours,
    )


def _is_latched(channel: Channel, described: LogChannel) -> bool:
    """Whether a log says that a channel is latched, or its messages describe fixed transforms."""
    about = channel.metadata
    return bool(
        about.get(LATCHED_KEY)
        or TRANSIENT_LOCAL.search(about.get(QOS_KEY, ""))
        or _has_fixed_transforms(described)
    )


def _has_fixed_transforms(channel: LogChannel) -> bool:
    name = channel.topic.rpartition("/")[2]
    return name == FIXED_TRANSFORMS and channel.type_name == TFMessage.type_name


def _latched_as(channel: LogChannel) -> ChannelKey:
    """Return the same key for channels of which only the newest message holds."""
    return channel.key if _has_fixed_transforms(channel) else channel.key._replace(sender="")


def _logged(messages: Iterable[PartMessage], known: Mapping[int, LogChannel]) -> Iterator[LoggedMessage]:
    for message in messages:
        if channel := known.get(message.channel_id):
            yield LoggedMessage(channel, message.sequence, message.time_ns, message.data)


def _newest_in(
    part: LogPart, channels: Mapping[int, LogChannel], until_ns: Mapping[int, int], missing: set[ChannelKey]
) -> Iterator[LoggedMessage]:
    """Yield the newest message of each missing channel in a part, and take the channel out of `missing`.

    Args:
        part: the file.
        channels: the channels by their ids in the file.
        until_ns: for each channel, leave out messages from this log time on.
        missing: keys of channels, as `_latched_as` returns them.
    """
    ids = {id_ for id_, channel in channels.items() if _latched_as(channel) in missing}
    for messages in part.blocks_backwards(ids, max(until_ns.values(), default=0)):
        newest: dict[ChannelKey, LoggedMessage] = {}
        for message in messages:
            if message.time_ns < until_ns[message.channel_id]:
                channel = channels[message.channel_id]
                newest[_latched_as(channel)] = LoggedMessage(
                    channel, message.sequence, message.publish_time_ns, message.data
                )
        yield from newest.values()
        missing.difference_update(newest)
        ids.difference_update([id_ for id_ in ids if _latched_as(channels[id_]) in newest])


def _schema_text(schema: Schema, stock: TypeRegistry) -> str | None:
    """Return the ros2msg text of a type; None if the log has none."""
    name = full_name(schema.name)
    if is_event_type(name):
        if not schema.data:
            return None
        with contextlib.suppress(SchemaError, UnicodeDecodeError):
            return event_schema(name, schema.data.decode())
    if schema.encoding != SCHEMA_ENCODING:
        return None
    if not schema.data and name in stock and fields_of(stock.get(name)):
        return None  # some writers leave out the text of a type that they do not find
    return schema.data.decode(errors="replace")


def _foreign_version(type_name: str, schema: str | None, stock: TypeRegistry) -> int:
    return version_of_foreign(stock.get(type_name), schema) if type_name in stock else 1


def version_of_foreign(ours: type[Message], schema: str | None) -> int:
    """Return the version of a type with a ros2msg text: our class's if both have the same layout, else 1."""
    return ours.version if schema is not None and has_layout(ours, schema) else 1


def has_layout(ours: type[Message], schema: str) -> bool:
    """Return whether a ros2msg text describes the layout of our class of that name."""
    try:
        return layout(message_type_from_schema(ours.type_name, schema)) == layout(ours)
    except MessageError:
        return False
