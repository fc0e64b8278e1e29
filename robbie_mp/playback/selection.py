"""Which channels of a log are played."""

from collections.abc import Collection, Iterable, Sequence
from fnmatch import fnmatchcase

from robbie_mp.messages import PlaybackControl, PlaybackState, Tick, TimeJump
from robbie_mp.recording.format import MESSAGE_ENCODING
from robbie_mp.recording.reader import LogChannel
from robbie_mp.recording.selection import select

NEVER = {kind.type_name for kind in (PlaybackControl, PlaybackState, Tick, TimeJump)}
"""What an earlier run said of its own time; it would contradict that of the run it is played into."""


def of_topics(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[LogChannel]:
    """Return the channels that fit one of the patterns (see `select`), and that can be played."""
    return [channel for channel in select(channels, patterns)[0] if _is_played(channel)]


def unmatched(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[str]:
    """Return the patterns that nothing fits that can be played."""
    return select(filter(_is_played, channels), patterns)[1]


def of_senders(
    channels: Iterable[LogChannel], senders: Sequence[str] | None, run: Collection[str]
) -> list[LogChannel]:
    """Return the channels of some senders.

    Args:
        channels: to choose from.
        senders: shell patterns; None: all that do not run in this run, for those send anew.
        run: names of what runs in it, other than the playback.
    """
    if senders is None:
        return [channel for channel in channels if channel.sender not in run]
    return [channel for channel in channels if any(fnmatchcase(channel.sender, sender) for sender in senders)]


def unplayable(channels: Iterable[LogChannel]) -> list[LogChannel]:
    """Return the channels whose messages are encoded in a way that nobody here reads."""
    return [channel for channel in channels if not _is_readable(channel)]


def _is_readable(channel: LogChannel) -> bool:
    return channel.encoding == MESSAGE_ENCODING and channel.type_name != ""


def _is_played(channel: LogChannel) -> bool:
    return _is_readable(channel) and channel.type_name not in NEVER
