"""Selects the channels of a log to play."""

from collections.abc import Collection, Iterable, Sequence
from fnmatch import fnmatchcase

from robbie_mp.logs.recording.format import MESSAGE_ENCODING
from robbie_mp.logs.recording.reader import LogChannel, select
from robbie_mp.messages import PlaybackControl, PlaybackState, Tick, TimeJump

NEVER = {kind.type_name for kind in (PlaybackControl, PlaybackState, Tick, TimeJump)}
"""The times that an earlier run published; they would contradict the time of the present run."""


def of_topics(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[LogChannel]:
    """Return the playable channels that match one of the patterns (see `select`)."""
    return [channel for channel in select(channels, patterns)[0] if _is_played(channel)]


def unmatched(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[str]:
    """Return the patterns that match no playable channel."""
    return select(filter(_is_played, channels), patterns)[1]


def of_senders(
    channels: Iterable[LogChannel], senders: Sequence[str] | None, run: Collection[str]
) -> list[LogChannel]:
    """Return the channels of some senders.

    Args:
        channels: to choose from.
        senders: shell patterns; None: all senders that do not run in this run, as those publish their own.
        run: names of the processes that run in it, other than the playback.
    """
    if senders is None:
        return [channel for channel in channels if channel.sender not in run]
    return [channel for channel in channels if any(fnmatchcase(channel.sender, sender) for sender in senders)]


def unplayable(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[LogChannel]:
    """Return the channels that match one of the patterns, but are in an encoding that cannot be read here."""
    return [channel for channel in select(channels, patterns)[0] if not is_readable(channel)]


def is_readable(channel: LogChannel) -> bool:
    """Whether this program can read the messages of a channel."""
    return channel.encoding == MESSAGE_ENCODING and channel.type_name != ""


def _is_played(channel: LogChannel) -> bool:
    return is_readable(channel) and channel.type_name not in NEVER
