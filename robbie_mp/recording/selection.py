"""Selects channels of a log by name."""

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from robbie_mp.recording.reader import LogChannel


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
