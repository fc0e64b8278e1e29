"""The file `metadata.yaml` in the folder of a recording, by which rosbag2 and rosbags open the folder.

Source: rosbag2's `rosbag2_storage/bag_metadata.hpp`, version 5 of the format (ROS 2 Humble); later
    versions of rosbag2 read it, too.
"""

import contextlib
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from robbie_mp.base.linux.private_files import write_private
from robbie_mp.logs.recording.contents import Contents
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.format import BAG_METADATA, LATCHED_KEY, QOS_KEY
from robbie_mp.logs.recording.limits import READ_LIMITS
from robbie_mp.logs.recording.reader import part_files
from robbie_mp.logs.recording.summary import read_summary

FORMAT_VERSION = 5
FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""A duration without an end, as rosbag2 writes it."""
OURS = "# Written by Robbie-MP\n"
"""First line of the file; no other file of that name is ever changed."""


def write_bag_metadata(folder: Path) -> str:
    """Write the file for the parts of a recording, in place of an older one of ours.

    It reads only the summaries of the parts. If a part has no end, there is no file: rosbag2 could not open
    that part.

    Args:
        folder: the folder of the recording.

    Returns:
        Why there is no file; '' if there is one.

    Raises:
        OSError: the file cannot be written.
        LogError: the folder has no parts of one log, or a part is too large.
    """
    path = folder / BAG_METADATA
    if not _is_ours(path):
        return f"{path} is of another program"
    contents: dict[Path, Contents] = {}
    for file in part_files(folder):
        found = _summary(file)
        if found is None:
            path.unlink(missing_ok=True)
            return f"{file} has no end"
        contents[file] = found
    write_private(path, OURS + yaml.safe_dump(_metadata(contents), sort_keys=False))
    return ""


def offered_qos(*, is_reliable: bool = True, is_latched: bool = False, depth: int = 1) -> str:
    """Return a quality of service as rosbag2 keeps it: with this `ros2 bag play` publishes the messages.

    Args:
        is_reliable: whether lost messages are sent again.
        is_latched: whether those who come later get the newest messages (transient local).
        depth: how many of them.
    """
    profile = {
        "history": 1,  # keep last
        "depth": depth,
        "reliability": 1 if is_reliable else 2,
        "durability": 1 if is_latched else 2,
        "deadline": dict(FOREVER),
        "lifespan": dict(FOREVER),
        "liveliness": 1,  # automatic
        "liveliness_lease_duration": dict(FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False).strip()


def update_bag_metadata(folder: Path) -> None:
    """Write the file again if there is one of ours, after parts were removed; without parts remove it."""
    path = folder / BAG_METADATA
    if not path.exists() or not _is_ours(path):
        return
    with contextlib.suppress(OSError, LogError):
        path.unlink()
        if any(folder.glob("*.mcap")):
            write_bag_metadata(folder)


def _is_ours(path: Path) -> bool:
    """Whether the file may be replaced: it was written by us, or does not exist."""
    try:
        with path.open() as file:
            return file.readline() == OURS
    except FileNotFoundError:
        return True
    except (OSError, ValueError):
        return False


def _summary(path: Path) -> Contents | None:
    try:
        with path.open("rb") as file:
            return read_summary(file, path.stat().st_size, READ_LIMITS)
    except (OSError, LogError):
        return None


def _metadata(contents: dict[Path, Contents]) -> dict[str, Any]:
    messages = {path: one.message_count for path, one in contents.items()}
    filled = [one for one in contents.values() if one.message_count]
    start_ns = min((one.start_ns for one in filled), default=0)
    end_ns = max((one.end_ns for one in filled), default=0)
    return {
        "rosbag2_bagfile_information": {
            "version": FORMAT_VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end_ns - start_ns},
            "starting_time": {"nanoseconds_since_epoch": start_ns},
            "message_count": sum(messages.values()),
            "topics_with_message_count": _topics(list(contents.values())),
            "compression_format": "",
            "compression_mode": "",  # MCAP compresses its chunks by itself
            "relative_file_paths": [path.name for path in contents],
            "files": [
                {
                    "path": path.name,
                    "starting_time": {"nanoseconds_since_epoch": one.start_ns},
                    "duration": {"nanoseconds": one.end_ns - one.start_ns},
                    "message_count": messages[path],
                }
                for path, one in contents.items()
            ],
        }
    }


def _topics(contents: list[Contents]) -> list[dict[str, Any]]:
    """Return a row for each topic, type and encoding; the senders are not told apart."""
    counts: Counter[tuple[str, str, str]] = Counter()
    qualities: dict[str, str] = {}
    for one in contents:
        for id_, channel in one.channels.items():
            schema = one.schemas.get(channel.schema_id)
            name = schema.name if schema else ""
            counts[channel.topic, name, channel.message_encoding] += one.counts.get(id_, 0)
            latched = offered_qos(is_latched=True) if channel.metadata.get(LATCHED_KEY) else ""
            if quality := channel.metadata.get(QOS_KEY) or latched:
                qualities.setdefault(channel.topic, quality)
    return [
        {
            "topic_metadata": {
                "name": topic,
                "type": type_name,
                "serialization_format": encoding,
                "offered_qos_profiles": qualities.get(topic, ""),
            },
            "message_count": count,
        }
        for (topic, type_name, encoding), count in counts.items()
    ]
