"""Logs for tests, written by the mcap library itself: what is read is not only what we write."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from robbie_mp import Header, Message, Time
from robbie_mp.messages import LaserScan, Odometry, schema_text

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000


class LogFile:
    """Writes a log as the contract has it; a context manager.

    Args:
        path: the file.
        options: of mcap's Writer.
    """

    def __init__(self, path: Path, *, profile: str = "ros2", **options: Any):
        self._file = path.open("wb")
        options.setdefault("compression", CompressionType.NONE)
        self.writer = Writer(self._file, **options)
        self.writer.start(profile, "robbie-mp test")
        self._channels: dict[tuple[str, str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._sequence = 0

    def add(
        self, message: Message, topic: str = "", sender: str = "base", *, time_ns: int = START_NS
    ) -> None:
        """Write a message."""
        kind = type(message)
        channel = self.channel(kind.type_name, schema_text(kind), kind.version, topic, sender)
        self.add_bytes(channel, message.encode(), time_ns)

    def add_bytes(self, channel: int, data: bytes, time_ns: int) -> None:
        """Write an encoded message."""
        self._sequence += 1
        self.writer.add_message(channel, time_ns, data, time_ns, self._sequence)

    def channel(self, type_name: str, schema: str, version: int, topic: str, sender: str) -> int:
        """Return the id of a channel."""
        key = (type_name, topic, sender)
        if type_name not in self._schemas:
            self._schemas[type_name] = self.writer.register_schema(type_name, "ros2msg", schema.encode())
        if key not in self._channels:
            about = {
                "robbie_topic": topic,
                "robbie_version": str(version),
                "robbie_sender": sender,
                "offered_qos_profiles": "",
            }
            name = "/" + (topic or type_name.rpartition("/")[2])
            self._channels[key] = self.writer.register_channel(name, "cdr", self._schemas[type_name], about)
        return self._channels[key]

    def __enter__(self) -> "LogFile":
        return self

    def __exit__(self, *_error: object) -> None:
        self.writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()


def scan(number: int, time_ns: int = START_NS, rays: int = 8) -> LaserScan:
    """A sweep that tells its number."""
    header = Header(stamp=Time.from_nanoseconds(time_ns), frame_id="laser")
    return LaserScan(header=header, ranges=np.full(rays, number, np.float32))


def traffic(count: int, step_ns: int = STEP_NS) -> Iterator[tuple[Message, str, str, int]]:
    """Messages of three channels: message, topic, sender, time."""
    for number in range(count):
        time_ns = START_NS + number * step_ns
        match number % 3:
            case 0:
                yield scan(number, time_ns), "laser/front", "laser", time_ns
            case 1:
                yield Odometry(child_frame_id=f"base {number}"), "odom", "base", time_ns
            case _:
                yield scan(number, time_ns), "", "laser", time_ns


def write_log(path: Path, count: int = 30, **options: Any) -> Path:
    """Write a log of `count` messages, with metadata, in chunks of about 1 kB."""
    options.setdefault("chunk_size", 1000)
    with LogFile(path, **options) as log:
        about = {"run_id": "0123abcd", "profile": "demo", "host": "h", "part": "0"}
        log.writer.add_metadata("robbie_run", about)
        log.writer.add_metadata("robbie_counts", {"channels": "[]"})
        for message, topic, sender, time_ns in traffic(count):
            log.add(message, topic, sender, time_ns=time_ns)
        counts = [{"type": "sensor_msgs/msg/LaserScan", "version": 1, "topic": "laser/front",
                   "sender": "laser", "recorded": (count + 2) // 3, "dropped": 2}]  # fmt: skip
        log.writer.add_metadata("robbie_counts", {"channels": json.dumps(counts)})
    return path


def write_small_log(path: Path, **options: Any) -> Path:
    """Write 5 messages of 5 bytes, on two channels, in two or three chunks."""
    with LogFile(path, chunk_size=130, **options) as log:
        log.writer.add_metadata("about", {"a": "b"})
        for number in range(5):
            channel = log.channel("a/msg/B", "uint8 x", 1, "even" if number % 2 else "odd", "s")
            log.add_bytes(channel, b"\0\1\0\0" + bytes([200 + number]), START_NS + number)
    return path
