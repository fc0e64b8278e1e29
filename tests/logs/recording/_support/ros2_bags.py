"""Bags of ROS 2 for tests: written here by the rules of rosbag2, in every version of its metadata."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from tests.logs.recording._support.logs import START_NS

STRING = "std_msgs/msg/String"
VOLATILE, LATCHED = 2, 1
"""Durabilities of rosbag2: volatile, transient local."""


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type_name: str = STRING
    definition: str | None = "string data\n"
    form: str = "ros2msg"
    durability: int = VOLATILE
    encoding: str = "cdr"


def text(value: str) -> bytes:
    """Return an encoded `std_msgs/msg/String`."""
    data = value.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


Row = tuple[Topic, int, bytes]


def rows(topics: list[Topic], count: int = 20) -> list[Row]:
    """Return messages of topics in turn."""
    return [(topics[n % len(topics)], START_NS + n, text(f"{n}")) for n in range(count)]


def write_mcap(path: Path, messages: list[Row]) -> None:
    """Write a file as rosbag2's plugin for MCAP does."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", "libmcap 1.3.0")
        channels: dict[Topic, int] = {}
        for topic, time_ns, data in messages:
            if topic not in channels:
                schema = writer.register_schema(
                    topic.type_name, topic.form, (topic.definition or "").encode()
                )
                about = {"offered_qos_profiles": qos(topic, 8)}
                channels[topic] = writer.register_channel(topic.name, topic.encoding, schema, about)
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def write_sqlite(path: Path, messages: list[Row], schema: int = 4) -> None:
    """Write a file as rosbag2's plugin for SQLite does.

    Args:
        path: the file.
        messages: what is in it.
        schema: the version of its tables: quality of service from 2, definitions from 4.
    """
    columns = "id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT"
    columns += ", offered_qos_profiles TEXT" * (schema >= 2) + ", type_description_hash TEXT" * (schema >= 4)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute(f"CREATE TABLE topics({columns})")
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        if schema >= 3:
            base.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT)")
            base.execute("INSERT INTO schema VALUES(?, 'jazzy')", [schema])
        if schema >= 4:
            base.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
                "encoded_message_definition TEXT, type_description_hash TEXT)"
            )
        ids: dict[Topic, int] = {}
        for topic, time_ns, data in messages:
            if topic not in ids:
                ids[topic] = len(ids) + 1
                row = [ids[topic], topic.name, topic.type_name, topic.encoding]
                row += [qos(topic, 9)] * (schema >= 2) + [""] * (schema >= 4)
                base.execute(f"INSERT INTO topics VALUES({', '.join('?' * len(row))})", row)
                if schema >= 4:
                    described = topic.type_name.removesuffix("_Event")
                    base.execute(
                        "INSERT INTO message_definitions VALUES(NULL, ?, ?, ?, '')",
                        [described, topic.form, topic.definition or ""],
                    )
            base.execute("INSERT INTO messages VALUES(NULL, ?, ?, ?)", [ids[topic], time_ns, data])


def qos(topic: Topic, version: int) -> str:
    """Return the quality of service of a topic as text."""
    durability: Any = (
        topic.durability if version < 9 else ("", "transient_local", "volatile")[topic.durability]
    )
    text_: str = yaml.safe_dump([{"history": 1, "depth": 5, "reliability": 1, "durability": durability}])
    return text_


def metadata(files: dict[str, list[Row]], storage: str, version: int = 9) -> dict[str, Any]:
    """Return what `metadata.yaml` says about a bag.

    Args:
        files: the messages of each file.
        storage: `mcap` or `sqlite3`.
        version: its version.
    """
    every = [row for one in files.values() for row in one]
    topics = []
    for topic in dict.fromkeys(row[0] for row in every):
        about: dict[str, Any] = {"name": topic.name, "type": topic.type_name, "serialization_format": "cdr"}
        if version >= 4:
            quality = qos(topic, version)
            about["offered_qos_profiles"] = quality if version < 9 else yaml.safe_load(quality)
        if version >= 7:
            about["type_description_hash"] = ""
        count = sum(row[0] == topic for row in every)
        topics.append({"topic_metadata": about, "message_count": count})
    found: dict[str, Any] = {
        "version": version,
        "storage_identifier": storage,
        "relative_file_paths": [f"bag/{name}" if version < 4 else name for name in files],
        "duration": {"nanoseconds": max(len(every) - 1, 0)},
        "starting_time": {"nanoseconds_since_epoch": START_NS},
        "message_count": len(every),
        "topics_with_message_count": topics,
    }
    if version >= 3:
        found |= {"compression_format": "", "compression_mode": ""}
    if version >= 5:
        found["files"] = [
            {
                "path": name,
                "starting_time": {"nanoseconds_since_epoch": START_NS},
                "duration": {"nanoseconds": 0},
                "message_count": len(one),
            }
            for name, one in files.items()
        ]
    if version >= 6:
        found["custom_data"] = None
    if version >= 8:
        found["ros_distro"] = "jazzy"
    return {"rosbag2_bagfile_information": found}


def write_bag(folder: Path, parts: list[list[Row]], storage: str, version: int = 9, schema: int = 4) -> Path:
    """Write a bag, one file for each part."""
    folder.mkdir()
    suffix = {"mcap": "mcap", "sqlite3": "db3"}[storage]
    files = {f"{folder.name}_{number}.{suffix}": part for number, part in enumerate(parts)}
    for name, part in files.items():
        if storage == "mcap":
            write_mcap(folder / name, part)
        else:
            write_sqlite(folder / name, part, schema)
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata(files, storage, version), sort_keys=False))
    return folder
