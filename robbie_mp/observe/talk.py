"""Who talks to whom."""

from collections import defaultdict
from dataclasses import dataclass

from robbie_mp.observe.figures import ChannelFigures, RunReading, SubscriptionFigures


@dataclass(frozen=True)
class Talk:
    """One channel with those at both of its ends."""

    channel: ChannelFigures
    publishers: tuple[str, ...]
    """Modules whose present incarnation has declared it."""
    subscribers: tuple[tuple[str, SubscriptionFigures], ...]
    """Modules and their subscriptions; one that asks for all topics is in several channels."""


def talk_of(reading: RunReading) -> list[Talk]:
    """Return all channels of a run, sorted by type and topic."""
    publishers: defaultdict[tuple[str, int, str], list[str]] = defaultdict(list)
    for module in reading.modules:
        for declared in module.publishes:
            publishers[declared].append(module.name)
    return [
        Talk(
            channel,
            tuple(publishers[channel.type_name, channel.version, channel.topic]),
            tuple(
                (module.name, entry)
                for module in reading.modules
                for entry in module.subscriptions
                if entry.is_open and _takes(entry, channel)
            ),
        )
        for channel in sorted(reading.channels, key=lambda one: (one.type_name, one.topic, one.version))
    ]


def _takes(entry: SubscriptionFigures, channel: ChannelFigures) -> bool:
    same_type = (entry.type_name, entry.version) == (channel.type_name, channel.version)
    return same_type and entry.topic in ("", channel.topic)
