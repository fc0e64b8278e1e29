"""Choosing messages by type or by topic, for all commands that take either."""

import argparse
from collections.abc import Iterable
from typing import NamedTuple

from robbie_mp.attached.views.known_channels import channels_of_run
from robbie_mp.attached.views.known_types import types_of_run
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli import completers
from robbie_mp.logs.capture.selection import WILDCARDS
from robbie_mp.messages import UnknownType
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.messages.registry import full_name
from robbie_mp.run.run_directory import KnownRun


class NoSuchMessages(RobbieError, LookupError):
    """A name on the command line does not say which messages are meant.

    Example scenarios:
      - neither a type nor a topic of the run has the name
      - a type has the name, and a topic too
      - messages of several types are on the topic
    """


class ChosenMessages(NamedTuple):
    """The messages that a command shall read or publish.

    Attributes:
        types: the types that the run knows.
        channel: type, version, and topic; '' for all topics.
    """

    types: KnownTypes
    channel: ChannelName


def add_messages_argument(parser: argparse.ArgumentParser, topic_help: str) -> None:
    """Add the argument and the option by which commands take a type or a topic."""
    name = parser.add_argument(
        "messages",
        metavar="TYPE|TOPIC",
        help="message type, such as sensor_msgs/LaserScan or LaserScan for short; or a topic of the run",
    )
    name.completer = completers.types_and_topics  # type: ignore[attr-defined]
    topic = parser.add_argument("--topic", default="", help=topic_help)
    topic.completer = completers.topics  # type: ignore[attr-defined]


def choose_messages(run: KnownRun, arguments: argparse.Namespace) -> ChosenMessages:
    """Return the messages that the arguments of `add_messages_argument` name.

    Raises:
        NoSuchMessages: the name is unknown, or names several things.
    """
    types = types_of_run(run)
    return ChosenMessages(
        types, choose_channel(arguments.messages, arguments.topic, types, channels_of_run(run))
    )


def choose_channel(name: str, topic: str, types: KnownTypes, channels: Iterable[ChannelName]) -> ChannelName:
    """Return the channel that a name stands for.

    A topic must be written exactly; a leading slash may be left out or added. A type may be written in full,
    as `package/Type`, or as `Type` in upper or lower case; a topic takes precedence over another case.

    Args:
        name: of a type or a topic.
        topic: the topic, if the user has given one besides; '' if not. Then `name` is a type.
        types: the types of the run.
        channels: the channels of the run.

    Raises:
        NoSuchMessages: the name is unknown, or names several things.
    """
    every = set(channels)
    if topic:
        return ChannelName(*_type(name, types, every), _known_topic(topic, every) or topic)
    on_topic = _known_topic(name, every)
    if not on_topic:
        return ChannelName(*_type(name, types, every), "")
    of_topic = sorted({channel.type_name for channel in every if channel.topic == on_topic})
    if same := _type_called(name, types):
        raise NoSuchMessages(
            f"{name!r} is a topic, and also the type {same}; write {same} for the type, and "
            f"{of_topic[0]} --topic {on_topic} for the topic"
        )
    if len(of_topic) > 1:
        raise NoSuchMessages(
            f"topic {on_topic!r} has messages of the types {', '.join(of_topic)}; name one of them, as in "
            f"{of_topic[0]} --topic {on_topic}"
        )
    return ChannelName(
        of_topic[0], _version(of_topic[0], types, {one for one in every if one.topic == on_topic}), on_topic
    )


def _known_topic(name: str, channels: Iterable[ChannelName]) -> str:
    """Return the topic of the run with this name; '' if there is none."""
    topics = {channel.topic for channel in channels} - {""}
    return next((one for one in (name, name.removeprefix("/"), f"/{name}") if one in topics), "")


def _type_called(name: str, types: KnownTypes) -> str:
    """Return the type with exactly this name; '' if there is none."""
    return next((one for one in types.names() if name in (one, short_name(one), last_name(one))), "")


def _type(name: str, types: KnownTypes, channels: set[ChannelName]) -> tuple[str, int]:
    try:
        found = types.find(name)
    except UnknownType as error:
        found = next((one.type_name for one in channels if one.type_name == full_name(name)), "")
        if not found:
            raise NoSuchMessages(_unknown(name, types, channels, str(error))) from None
    return found, _version(found, types, channels)


def _unknown(name: str, types: KnownTypes, channels: set[ChannelName], said: str) -> str:
    same = [one for one in types.names() if last_name(one).lower() == last_name(name).lower()]
    if same:  # the name is right, but not its package; or it is ambiguous
        return said
    known = [last_name(one) for one in types.names()] + sorted({one.topic for one in channels} - {""})
    if "/" in name:
        known += map(short_name, types.names())
    return f"no message type and no topic is called {name!r}{did_you_mean(name, known)}"


def unknown_names(run: KnownRun, patterns: Iterable[str]) -> list[str]:
    """Say for each name of a type or topic that a run does not know it; wildcards may match later."""
    types, channels = types_of_run(run), set(channels_of_run(run))
    names = [one for one in patterns if WILDCARDS.isdisjoint(one)]
    called = {*types.names(), *map(short_name, types.names()), *map(last_name, types.names())}
    called |= {one.topic for one in channels} | {last_name(one.type_name) for one in channels}
    called |= {full_name(one) for one in called}
    return [
        _unknown(name, types, channels, f"no type is called {name!r}") for name in names if name not in called
    ]


def _version(type_name: str, types: KnownTypes, channels: Iterable[ChannelName]) -> int:
    used = {one.version for one in channels if one.type_name == type_name}
    try:
        newest = types.describe(type_name).version
    except UnknownType:
        return max(used, default=1)
    return newest if newest in used or not used else max(used)  # a run knows versions that nobody uses


def short_name(type_name: str) -> str:
    """Return the name of a type without `msg`: `sensor_msgs/LaserScan`."""
    return type_name.replace("/msg/", "/")


def last_name(type_name: str) -> str:
    """Return the last part of a type's name: `LaserScan`."""
    return type_name.rpartition("/")[2]


def nobody_subscribes(channel: ChannelName, subscribed: Iterable[ChannelName]) -> str:
    """Say that nobody subscribes to a channel, and what is near; '' if somebody does.

    Args:
        channel: the channel.
        subscribed: the subscriptions of a run.
    """
    wanted = list(subscribed)
    if any(one.takes(channel) for one in wanted):
        return ""
    topics = sorted({one.topic for one in wanted if one[:2] == channel[:2]})
    name = channel.type_name
    if not topics:
        return f"nobody subscribes to {name}; `robbie list topics` shows what the modules take"
    others = did_you_mean(channel.topic, topics) or f"; it is taken on {', '.join(map(repr, topics))}"
    return f"nobody subscribes to {name} on topic {channel.topic!r}{others}"


def nobody_publishes(channel: ChannelName, published: Iterable[ChannelName]) -> str:
    """Say that no module publishes on a channel; '' if one does.

    Args:
        channel: the channel; topic '' for all topics.
        published: the channels on which modules publish.
    """
    name = channel.type_name
    topics = sorted({one.topic for one in published if one[:2] == channel[:2]})
    if not topics:
        return f"no module publishes {name}"
    if channel.topic and channel.topic not in topics:
        others = ", ".join(repr(topic) if topic else "messages without a topic" for topic in topics)
        return f"no module publishes {name} on topic {channel.topic!r}; there are {others}"
    return ""
