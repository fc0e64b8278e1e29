"""Subscriptions that no module publishes for: the usual reason why a robot stands still without an error."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName

PATIENCE_S = 10.0
"""How long a module may have no publisher before its subscription counts as unconnected, in s."""
MAX_NAMED = 3
"""How many topics, versions or modules an explanation names."""


@dataclass(frozen=True)
class Unconnected:
    """A subscription for which nobody has published."""

    type_name: str
    version: int
    topic: str
    """'' for all topics."""
    why: str
    """The nearest thing that is published instead, in words."""

    def __str__(self) -> str:
        return f"gets no {what(self.type_name, self.topic)}: {self.why}"


def unconnected(
    subscriptions: Iterable[ChannelName], published: Mapping[ChannelName, Sequence[str]]
) -> list[Unconnected]:
    """Return the subscriptions that match no channel. Subscriptions by patterns may match none.

    Args:
        subscriptions: type, version and topic of each.
        published: all channels, with the modules that publish to them now; there may be none any more.
    """
    return [
        Unconnected(*wanted, _why(wanted, published))
        for wanted in subscriptions
        if wanted.version != ANY_VERSION and not any(wanted.takes(channel) for channel in published)
    ]


def _why(wanted: ChannelName, published: Mapping[ChannelName, Sequence[str]]) -> str:
    """Say what comes nearest: another version on the topic, another topic, another type."""
    same_type = [channel for channel in published if channel.type_name == wanted.type_name]
    other_versions = [channel for channel in same_type if channel.version != wanted.version]
    here = [channel for channel in other_versions if wanted.topic in ("", channel.topic)]
    other_topics = [channel for channel in same_type if channel.version == wanted.version]
    if not here and other_topics:
        topics = _listed(f"'{channel.topic}'" for channel in other_topics)
        return f"it is published only on topic {topics}{_by(other_topics, published)}"
    if found := here or other_versions:
        versions = _listed(str(channel.version) for channel in found)
        return (
            f"only version {versions} is published{_by(found, published)}, "
            f"and this is a subscription to version {wanted.version}"
        )
    others = [channel for channel in published if wanted.topic and channel.topic == wanted.topic]
    types = _listed(what(channel.type_name, "") for channel in others)
    carries = f"; topic '{wanted.topic}' carries {types}{_by(others, published)}" if others else ""
    return f"nobody publishes it{carries}"


def _by(channels: Sequence[ChannelName], published: Mapping[ChannelName, Sequence[str]]) -> str:
    modules = _listed(module for channel in channels for module in published[channel])
    return f" (by {modules})" if modules else ""


def _listed(words: Iterable[str]) -> str:
    different = list(dict.fromkeys(words))
    more = ["…"] if len(different) > MAX_NAMED else []
    return ", ".join(different[:MAX_NAMED] + more)


def what(type_name: str, topic: str) -> str:
    """Name the messages of a subscription, with a topic of '' for all topics."""
    short = type_name.replace("/msg/", "/")
    return f"{short} on topic '{topic}'" if topic else short
