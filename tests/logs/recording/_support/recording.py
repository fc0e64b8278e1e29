"""Recordings for tests, and what others read in them."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from robbie_mp import Header, Time
from robbie_mp.logs.recording.chunk import Chunk, Compression
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey, RunMetadata
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.part_writer import RecordedChannel
from robbie_mp.messages import LaserScan, Odometry, schema_text

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
RUN = RunMetadata("12ab", "demo", "lisa", "0.1.0", "3.11", 0, 0, 0, "system", "modules: {}\n")
CHANNELS = {
    1: RecordedChannel(1, ChannelKey(LaserScan.type_name, 1, "front", "laser"), schema_text(LaserScan)),
    2: RecordedChannel(2, ChannelKey(Odometry.type_name, 1, "", "base"), schema_text(Odometry)),
    3: RecordedChannel(3, ChannelKey(LaserScan.type_name, 1, "front", "spare"), schema_text(LaserScan)),
}


def message(number: int) -> tuple[int, LaserScan | Odometry]:
    """Return a message of one of the channels, and the channel."""
    header = Header(stamp=Time(sec=number), frame_id="robot")
    if number % 3 == 1:
        return 2, Odometry(header=header, child_frame_id=str(number))
    ranges = np.array([number + 0.25 * i for i in range(40)], np.float32)
    return 1 + number % 3, LaserScan(header=header, range_max=8.0, ranges=ranges)


def chunk_of(numbers: Iterable[int]) -> Chunk:
    """Put messages into a chunk."""
    chunk = Chunk(0)
    for number in numbers:
        channel, content = message(number)
        chunk.add(channel, number, START_NS + number * STEP_NS, content.encode())
    return chunk


def writer(
    folder: Path,
    compression: Compression = Compression.NONE,
    *,
    split: Split | None = None,
    budget: int = 0,
    dropped: Mapping[ChannelKey, int] | None = None,
) -> LogWriter:
    """Begin a recording."""
    room = DiskBudget(folder.parent, budget)
    return LogWriter(folder, compression, RUN, split or Split(), room, lambda: dropped or {})


def as_others_read(path: Path) -> list[tuple[str, int, int, Any]]:
    """Return topic, sequence, time and decoded message of all messages, as mcap-ros2-support reads them."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        return [
            (channel.topic, record.sequence, record.log_time, decoded)
            for _, channel, record, decoded in reader.iter_decoded_messages(log_time_order=False)
        ]
