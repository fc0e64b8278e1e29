"""The rules of our logs beyond those of MCAP: names, metadata, and how channels are described.

A recording is a folder of parts, `NAME/NAME_0000.mcap`, `NAME/NAME_0001.mcap` …, and each part is a complete
log. Messages are stored unchanged, as CDR with its encapsulation header. Schemas are ros2msg texts, and the
profile is "ros2", so ROS 2 tools can read the files. Source: https://mcap.dev/spec.
"""

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from typing_extensions import Self

from robbie_mp.logs.recording.topic_names import ros_topic, snake_case

PROFILE = "ros2"
MESSAGE_ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"
RUN_METADATA = "robbie_run"
COUNTS_METADATA = "robbie_counts"
CHANNELS_KEY = "channels"
TOPIC_KEY = "robbie_topic"
VERSION_KEY = "robbie_version"
SENDER_KEY = "robbie_sender"
QOS_KEY = "offered_qos_profiles"
LATCHED_KEY = "robbie_latched"
CARRIED_KEY = "robbie_carried"
PART_NAME = re.compile(r"(?P<name>.+)_(?P<number>\d{4,})\.mcap")
BAG_PART_NAME = re.compile(r"(?P<name>.+)_(?P<number>\d+)\.mcap")
"""Name of a part in a folder of rosbag2."""
BAG_METADATA = "metadata.yaml"
"""The file in a folder of rosbag2 that describes the parts."""


def part_path(folder: Path, number: int) -> Path:
    """Return the path of a part of the recording in a folder."""
    return folder / f"{folder.name}_{number:04}.mcap"


class ChannelKey(NamedTuple):
    """The key of one channel of a log."""

    type_name: str
    version: int
    topic: str
    sender: str
    """The module that published the messages; '' if it is not known."""

    def metadata(self) -> dict[str, str]:
        """Return the metadata of the channel in the log."""
        return {
            TOPIC_KEY: self.topic,
            VERSION_KEY: str(self.version),
            SENDER_KEY: self.sender,
            QOS_KEY: "",
        }


class TopicNames:
    """The topics of channels in one log: two types never share a topic, as in ROS."""

    def __init__(self) -> None:
        self._type_of: dict[str, str] = {}

    def of(self, key: ChannelKey) -> str:
        """Return the MCAP topic of a channel, as all of ROS sees it; longer if another type has it."""
        short = snake_case(key.type_name)
        base = f"/{ros_topic(key.type_name, key.topic)}"
        for topic in (base, f"{base}/{short}", f"{base}/{key.type_name}"):
            if self._type_of.setdefault(topic, key.type_name) == key.type_name:
                return topic
        raise AssertionError("only one type has the last name")


@dataclass(frozen=True)
class RunMetadata:
    """The record `robbie_run` at the start of a part."""

    run_id: str
    profile: str
    host: str
    version: str
    """Version of Robbie-MP."""
    python: str
    part: int
    first_sequence: int
    """Sequence number of the part's first message, in the order of the run."""
    started_ns: int
    """When the part was started, on the clock of its messages."""
    clock: str
    """The clock of the messages."""
    profile_yaml: str
    """The merged profile."""

    def as_metadata(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        return {name: str(value) for name, value in asdict(self).items()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> Self:
        """Read a metadata record; a value that is missing or not a number becomes '' or 0."""
        values: dict[str, str | int] = {name: metadata.get(name, "") for name in cls.__annotations__}
        for name in ("part", "first_sequence", "started_ns"):
            text = str(values[name])
            values[name] = int(text) if text.isdecimal() else 0
        return cls(**values)  # type: ignore[arg-type]


@dataclass
class RecordedCount:
    """How many messages of a channel were written and how many are missing, in one part of a recording."""

    recorded: int = 0
    """Messages in the log."""
    dropped: int = 0
    """Messages missing from it: from the end of the previous part to the end of this one."""


def counts_metadata(counts: Iterable[tuple[ChannelKey, RecordedCount]]) -> dict[str, str]:
    """Return the content of a record `robbie_counts`; the last one in a part covers the whole part."""
    rows = [
        {
            "type": key.type_name,
            "version": key.version,
            "topic": key.topic,
            "sender": key.sender,
            "recorded": count.recorded,
            "dropped": count.dropped,
        }
        for key, count in counts
    ]
    return {CHANNELS_KEY: json.dumps(rows, separators=(",", ":"))}


def counts_from_metadata(metadata: dict[str, str]) -> dict[ChannelKey, RecordedCount]:
    """Read a record `robbie_counts`.

    Raises:
        ValueError: the metadata are not such a record.
    """
    try:
        return dict(map(_count, json.loads(metadata[CHANNELS_KEY])))
    except (KeyError, TypeError) as error:
        raise ValueError(f"this is no record {COUNTS_METADATA}: {error}") from error


def _count(row: dict[str, Any]) -> tuple[ChannelKey, RecordedCount]:
    key = ChannelKey(str(row["type"]), int(row["version"]), str(row["topic"]), str(row["sender"]))
    return key, RecordedCount(int(row["recorded"]), int(row["dropped"]))
