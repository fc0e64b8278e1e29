"""Which channels of a log are played."""

from collections.abc import Collection, Iterable, Sequence
from fnmatch import fnmatchcase

from robbie_mp.messages import PlaybackControl, PlaybackState, TimeJump
from robbie_mp.recording.reader import LogChannel
from robbie_mp.recording.selection import channel_name

NEVER = {PlaybackControl.type_name, PlaybackState.type_name, TimeJump.type_name}
"""What an earlier playback said and was told; it would steer or contradict the one that plays it."""
ENCODING = "cdr"


def of_topics(channels: Iterable[LogChannel], patterns: Sequence[str]) -> list[LogChannel]:
    """Return the channels that fit one of the shell patterns, and that can be published."""
    bare = [pattern.removeprefix("/") for pattern in patterns]
    return [
        channel
        for channel in channels
        if channel.type_name not in NEVER
        and channel.encoding == ENCODING
        and any(fnmatchcase(channel_name(channel), pattern) for pattern in bare)
    ]


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


def unmatched(channels: Sequence[LogChannel], patterns: Sequence[str]) -> list[str]:
    """Return the patterns that no channel of a log fits."""
    return [pattern for pattern in patterns if not of_topics(channels, [pattern])]


def unplayable(channels: Iterable[LogChannel]) -> list[LogChannel]:
    """Return the channels whose messages are encoded in a way that nobody here reads."""
    return [channel for channel in channels if channel.encoding != ENCODING or not channel.type_name]
