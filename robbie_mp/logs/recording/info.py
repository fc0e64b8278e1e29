"""Describes a log in figures."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.errors import NotDecodable
from robbie_mp.logs.recording.format import (
    CARRIED_KEY,
    COUNTS_METADATA,
    RUN_METADATA,
    ChannelKey,
    RecordedCount,
    RunMetadata,
    counts_from_metadata,
)
from robbie_mp.logs.recording.part import LogPart
from robbie_mp.logs.recording.reader import Log, LogChannel
from robbie_mp.logs.recording.repair import REPAIR_METADATA
from robbie_mp.logs.recording.time_jumps import LogTimeJump, time_jumps
from robbie_mp.messages.errors import SchemaError

MAX_JUMPS = 20
"""Shown of one log."""


@dataclass(frozen=True)
class ChannelInfo:
    """One channel of a log.

    Attributes:
        channel: type, version, topic and sender.
        messages: number of messages.
        hz: mean message rate over the time of the whole log; 0 if the log spans no time.
        dropped: number of messages the logger could not write; None if it has not reported it.
        carried: number of copies of older messages, at the beginning of parts; they are not in `messages`.
    """

    channel: LogChannel
    messages: int
    hz: float
    dropped: int | None
    carried: int = 0

    def as_data(self) -> dict[str, Any]:
        """Return what `robbie info --json` prints about the channel."""
        channel = self.channel
        return {
            "topic": channel.topic,
            "type": channel.type_name,
            "version": channel.version,
            "sender": channel.sender,
            "messages": self.messages,
            "hz": self.hz,
            "dropped": self.dropped,
            "is_latched": channel.is_latched,
            "carried": self.carried,
        }


@dataclass(frozen=True)
class LogInfo:
    """A log in figures.

    Attributes:
        path: the file or folder.
        parts: its files.
        run: the run it was recorded in; None if the log does not say.
        library: the name of the program that wrote it.
        channels: in the order in which they were opened.
        start_ns: time of the earliest message; 0 if there is none.
        end_ns: time of the latest message; 0 if there is none.
        damage: one line for each damaged place.
        left_out: how many messages an export or a playback cannot read, by reason; damage is not counted.
        time_jumps: where its time jumps; the first of them.
        more_time_jumps: how many follow.
    """

    path: Path
    parts: list[LogPart]
    run: RunMetadata | None
    library: str
    channels: list[ChannelInfo]
    start_ns: int
    end_ns: int
    damage: list[str]
    left_out: dict[str, int]
    time_jumps: list[LogTimeJump]
    more_time_jumps: int

    @property
    def duration_s(self) -> float:
        """Time from the earliest message to the latest."""
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def bytes(self) -> int:
        """Size of all files."""
        return sum(part.size for part in self.parts)

    @property
    def messages(self) -> int:
        """Messages in all channels."""
        return sum(channel.messages for channel in self.channels)

    @property
    def is_being_written(self) -> bool:
        """Whether a logger is writing its last part."""
        return any(part.is_being_written for part in self.parts)

    @property
    def compressions(self) -> list[str]:
        """The compressions of the chunks."""
        return sorted({name or "none" for part in self.parts for name in part.contents.compressions})

    def as_data(self) -> dict[str, Any]:
        """Return what `robbie info --json` prints."""
        return {
            "path": str(self.path),
            "kind": "log",
            "is_complete": not self.damage,
            "is_being_written": self.is_being_written,
            "damage": self.damage,
            "left_out": self.left_out,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "duration_s": self.duration_s,
            "time_jumps": [jump._asdict() for jump in self.time_jumps],
            "more_time_jumps": self.more_time_jumps,
            "bytes": self.bytes,
            "messages": self.messages,
            "library": self.library,
            "compressions": self.compressions,
            "run": self.run and {name: getattr(self.run, name) for name in RUN_KEYS},
            "channels": [channel.as_data() for channel in self.channels],
            "parts": [part_data(part) for part in self.parts],
        }


RUN_KEYS = ("run_id", "profile", "host", "version", "python", "clock", "started_ns")


def describe(log: Log) -> LogInfo:
    """Describe a log in figures."""
    runs = log.metadata(RUN_METADATA)
    dropped, carried = _dropped(log.parts), log.carried_counts
    duration_s = (log.end_ns - log.start_ns) / 1e9
    jumps = time_jumps(log)
    return LogInfo(
        path=log.path,
        parts=log.parts,
        run=RunMetadata.from_metadata(runs[0]) if runs else None,
        library=log.parts[0].contents.header.library,
        channels=[
            *(
                ChannelInfo(
                    channel,
                    count,
                    count / duration_s if duration_s else 0.0,
                    dropped.get(channel.key),
                    carried[channel],
                )
                for channel, count in log.counts.items()
            ),
            *_missing_altogether(log, dropped),
        ],
        start_ns=log.start_ns,
        end_ns=log.end_ns,
        time_jumps=list(islice(jumps, MAX_JUMPS)),
        more_time_jumps=sum(1 for _ in jumps),
        damage=log.damage,
        left_out=_left_out(log).left_out,
    )


def _left_out(log: Log) -> Balance:
    balance = Balance()
    for channel, count in log.counts.items():
        try:
            logged_type(channel)
        except (NotDecodable, SchemaError) as error:
            balance.leave_out(str(error), count)
    return balance


def part_data(part: LogPart) -> dict[str, Any]:
    """Return the printed description of one file."""
    contents = part.contents
    carried = sum(
        contents.counts.get(id_, 0)
        for id_, channel in contents.channels.items()
        if channel.metadata.get(CARRIED_KEY)
    )
    return {
        "path": str(part.path),
        "bytes": part.size,
        "messages": contents.message_count - carried,
        "carried": carried,
        "chunks": sum(contents.compressions.values()),
        "start_ns": contents.start_ns,
        "end_ns": contents.end_ns,
        "is_complete": part.is_complete,
        "is_repaired": any(record.name == REPAIR_METADATA for record in contents.metadata),
    }


def _dropped(parts: list[LogPart]) -> dict[ChannelKey, int]:
    dropped: dict[ChannelKey, int] = {}
    for part in parts:
        for key, count in last_counts(part).items():
            dropped[key] = dropped.get(key, 0) + count.dropped
    return dropped


def last_counts(part: LogPart) -> dict[ChannelKey, RecordedCount]:
    """Return the content of the last record `robbie_counts` of a file; {} if it has none."""
    for record in reversed(part.contents.metadata):
        if record.name == COUNTS_METADATA:
            with contextlib.suppress(ValueError):
                return counts_from_metadata(record.metadata)
    return {}


def _missing_altogether(log: Log, dropped: dict[ChannelKey, int]) -> Iterator[ChannelInfo]:
    """Yield dropped channels that are not in the log: no message arrived, or the sender is not known."""
    recorded = {channel.key for channel in log.channels}
    for key, count in dropped.items():
        if count and key not in recorded:
            yield ChannelInfo(LogChannel(-1, *key, schema=None), 0, 0.0, count)
