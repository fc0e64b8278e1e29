"""Writes a log as a bag of ROS 2: a folder with an MCAP file and `metadata.yaml`, which rosbag2 opens.

Messages keep their bytes, times and definitions; topics get the names that ROS 2 sees. If the robot that
wrote the log had a bridge to ROS 2, these are the names that the bridge's `send` gives.
"""

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from robbie_mp.base.balance import Balance
from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import read_text
from robbie_mp.connect.bridge.mapping import MAX_DEPTH, BridgeMap, MappingError, Quality
from robbie_mp.logs.recording.bag_metadata import offered_qos, write_bag_metadata
from robbie_mp.logs.recording.conversion import NewChannel, converted_log
from robbie_mp.logs.recording.errors import LogNotWritten
from robbie_mp.logs.recording.format import (
    BAG_METADATA,
    LATCHED_KEY,
    MESSAGE_ENCODING,
    QOS_KEY,
    RUN_METADATA,
    RunMetadata,
    part_path,
)
from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage
from robbie_mp.logs.recording.repair import Progress
from robbie_mp.logs.recording.topic_names import ros_topic, snake_case
from robbie_mp.messages import TFMessage
from robbie_mp.messages.service_events import is_event_type

BRIDGE_CLASS = "robbie_mp.connect.ros2.module:Ros2Bridge"


class BridgeOfLog(NamedTuple):
    """The bridge to ROS 2 of the robot that wrote a log.

    Attributes:
        module: its name in the profile; "" if the robot had none.
        map: which of its messages have which names.
    """

    module: str
    map: BridgeMap


@dataclass(frozen=True)
class BagChannel:
    """A channel as it is in the bag.

    Attributes:
        name: its name in ROS.
        quality: how its messages are published again, as far as it is known.
    """

    name: str
    quality: Quality


def bridge_of_log(log: Log) -> BridgeOfLog:
    """Return the first bridge to ROS 2 in the profile that a log was recorded with."""
    for record in log.metadata(RUN_METADATA):
        modules = _modules(RunMetadata.from_metadata(record).profile_yaml)
        for name, module in modules.items():
            settings = module.get("settings") if isinstance(module, Mapping) else None
            if isinstance(settings, Mapping) and module.get("class") == BRIDGE_CLASS:
                with contextlib.suppress(MappingError, AttributeError, TypeError):  # anybody may write a log
                    made = BridgeMap(settings.get("send") or {}, {}, str(settings.get("namespace") or ""))
                    return BridgeOfLog(str(name), made)
    return BridgeOfLog("", BridgeMap({}, {}))


def _modules(profile: str) -> Mapping[Any, Any]:
    try:
        merged = read_text(profile, "the profile of the log").plain()
    except ProfileError:
        return {}
    modules = merged.get("modules") if isinstance(merged, Mapping) else None
    return modules if isinstance(modules, Mapping) else {}


def bag_channels(channels: Iterable[LogChannel], names: BridgeMap) -> dict[LogChannel, BagChannel]:
    """Return how each channel of a log is called in a bag.

    What the bridge does not send has its topic as its name, or without one its type: `laser/front` is
    `/laser/front`, and a scan without a topic is `/laser_scan`. If two definitions of a type, or two types,
    would have one name, the type follows for the second: `/laser/front/image`.

    Args:
        channels: the channels.
        names: the names that the bridge gives.
    """
    every = list(channels)
    sent = {one: names.sent_as(one.type_name, one.topic) for one in every}
    owners: dict[str, tuple[str, str | None]] = {}
    found: dict[LogChannel, BagChannel] = {}
    for channel in sorted(every, key=lambda one: sent[one] is None):  # the names of the bridge come first
        as_sent = sent[channel]
        short = snake_case(channel.type_name)
        name = as_sent.name if as_sent else f"/{ros_topic(channel.type_name, channel.topic)}"
        about = (channel.type_name, channel.schema)
        longer = chain((name, f"{name}/{short}"), (f"{name}/{short}_{number}" for number in count(2)))
        free = next(candidate for candidate in longer if owners.setdefault(candidate, about) == about)
        found[channel] = BagChannel(free, _quality(channel, as_sent.quality if as_sent else None))
    return found


def _quality(channel: LogChannel, sent: Quality | None) -> Quality:
    quality = sent or Quality()
    if not channel.is_latched:
        return quality
    # One publisher sends what several modules have sent, and each message of theirs is to arrive.
    depth = MAX_DEPTH if channel.type_name == TFMessage.type_name else 1
    return replace(quality, is_latched=True, depth=max(depth, sent.depth) if sent else depth)


def export_bag(
    log: Log,
    folder: Path,
    channels: Iterable[LogChannel],
    names: BridgeMap,
    balance: Balance,
    progress: Progress,
) -> None:
    """Write a bag of ROS 2 with messages of a log.

    The bag begins with what was newest on latched topics before the log began. Its channels also say how the
    robot called them, so that Robbie-MP reads the folder as the log that it was made of.

    Args:
        log: the log.
        folder: the bag, which must not exist. If writing fails, it is removed.
        channels: the channels of the log whose messages are written.
        names: the names that the robot's bridge to ROS 2 gives; see `bridge_of_log`.
        balance: counts the messages in the bag, and those that cannot be in a bag.
        progress: counts messages.

    Raises:
        LogNotWritten: the folder exists, or cannot be written.
        LeftOut: the balance allows no loss.
    """
    chosen = list(channels)
    problems = {channel: problem for channel in chosen if (problem := _problem(channel))}
    named = bag_channels([channel for channel in chosen if channel not in problems], names)
    written = {channel: _written(channel, one) for channel, one in named.items()}
    _make(folder)
    target = part_path(folder, 0)
    try:
        with converted_log(target, log.path, balance) as made:
            total = log.message_count
            for done, message in enumerate(_messages(log, chosen), start=1):
                progress(done, total)
                if message.channel in problems:
                    balance.leave_out(problems[message.channel])
                else:
                    made.add(*written[message.channel], message.time_ns, message.data)
            log.count_damage(balance)
        write_bag_metadata(folder)
    except OSError as error:
        _remove(folder)
        if isinstance(error, LogNotWritten):
            raise
        raise LogNotWritten(f"{folder} cannot be written: {error.strerror}") from error
    except BaseException:
        _remove(folder)
        raise


def _messages(log: Log, chosen: list[LogChannel]) -> Iterable[LoggedMessage]:
    for message in log.newest_latched(log.start_ns, chosen):
        yield message._replace(time_ns=log.start_ns)
    yield from log.messages(channels=chosen)


def _problem(channel: LogChannel) -> str:
    """Return why messages of a channel cannot be in a bag; "" if they can."""
    if channel.encoding != MESSAGE_ENCODING:
        return f"messages of {channel.topic!r}, whose encoding is {channel.encoding!r}, not CDR"
    if channel.schema is None:
        return f"messages of {channel.topic or channel.type_name!r}, whose type has no definition in the log"
    if "/msg/" not in channel.type_name and not is_event_type(channel.type_name):
        return f"messages of type {channel.type_name}: in ROS, they are no messages of a topic"
    return ""


def _written(channel: LogChannel, one: BagChannel) -> tuple[NewChannel, dict[str, str]]:
    """Return a channel as it is written, with its metadata, also those by which Robbie-MP knows it again."""
    new = NewChannel(one.name, channel.type_name, channel.schema or "", channel.sender, channel.topic)
    about = {} if channel.is_foreign else channel.key.metadata()
    quality = one.quality
    text = offered_qos(is_reliable=quality.is_reliable, is_latched=quality.is_latched, depth=quality.depth)
    return new, about | {QOS_KEY: text} | ({LATCHED_KEY: "1"} if quality.is_latched else {})


def _make(folder: Path) -> None:
    try:
        make_private_folder(folder.parent.resolve())
        folder.mkdir(mode=0o700)
    except OSError as error:
        raise LogNotWritten(f"{folder} cannot be written: {error.strerror}") from error


def _remove(folder: Path) -> None:
    with contextlib.suppress(OSError):
        (folder / BAG_METADATA).unlink(missing_ok=True)
        part_path(folder, 0).unlink(missing_ok=True)
        folder.rmdir()
