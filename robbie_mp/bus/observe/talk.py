"""Which modules communicate with each other."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from robbie_mp.bus.observe.figures import ChannelFigures, RunReading, SubscriptionFigures
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName


@dataclass(frozen=True)
class Talk:
    """One channel with its publishers and subscribers."""

    channel: ChannelFigures
    publishers: tuple[str, ...]
    """Modules whose present incarnation has declared it."""
    subscribers: tuple[tuple[str, SubscriptionFigures], ...]
    """Modules and their subscriptions; a subscription to all topics or by patterns is in several channels."""


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
                for entry in _taking(channel, module.subscriptions)
            ),
        )
        for channel in sorted(reading.channels, key=lambda one: (one.type_name, one.topic, one.version))
    ]


def _taking(
    channel: ChannelFigures, subscriptions: Sequence[SubscriptionFigures]
) -> list[SubscriptionFigures]:
    """Return a module's subscriptions that receive a channel's messages: at most one of those by patterns."""
    name = ChannelName(channel.type_name, channel.version, channel.topic)
    taking = [
        entry
        for entry in subscriptions
        if entry.is_open
        and not entry.is_latch
        and ChannelName(entry.type_name, entry.version, entry.topic).takes(name)
    ]
    by_pattern = [entry for entry in taking if entry.version == ANY_VERSION]
    return [entry for entry in taking if entry not in by_pattern[1:]]
