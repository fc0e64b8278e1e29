"""`metadata.yaml` lets rosbags open the folder of a recording."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from robbie_mp.cli import main
from robbie_mp.logs.recording.bag_metadata import write_bag_metadata
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.format import BAG_METADATA
from robbie_mp.logs.recording.log_writer import Split
from tests.logs.recording._support.recording import CHANNELS, START_NS, STEP_NS, chunk_of, message, writer

TOPICS = {"/front": 20, "/odometry": 10}


def record(folder: Path, chunks: int = 6, budget: int = 0) -> Path:
    """Record three parts, of 10 messages each."""
    made = writer(folder, Compression.ZSTD, split=Split(seconds=0.095), budget=budget)
    for first in range(0, 5 * chunks, 5):
        made.write(chunk_of(range(first, first + 5)), CHANNELS)
    made.close()
    return folder


def topics(folder: Path) -> dict[str, int]:
    """Count what rosbags reads, and compare it with what the file says."""
    with Reader(folder) as bag:
        said = {one.topic: one.msgcount for one in bag.connections}
        found = Counter(connection.topic for connection, _, _ in bag.messages())
        assert found == said
        assert bag.message_count == sum(said.values())
        return said


def test_rosbags_opens_the_folder_of_a_recording(tmp_path: Path) -> None:
    folder = record(tmp_path / "monday")
    assert topics(folder) == TOPICS
    with AnyReader([folder]) as bag:
        assert bag.start_time == START_NS
        assert bag.duration == 29 * STEP_NS + 1
        for connection, time_ns, data in bag.messages():
            number = (time_ns - START_NS) // STEP_NS
            assert data == message(number)[1].encode()
            decoded: Any = bag.deserialize(data, connection.msgtype)
            assert decoded.header.stamp.sec == number
    assert (folder / BAG_METADATA).stat().st_mode & 0o077 == 0
    said = yaml.safe_load((folder / BAG_METADATA).read_text())["rosbag2_bagfile_information"]
    assert (said["version"], said["storage_identifier"]) == (5, "mcap")
    assert said["relative_file_paths"] == sorted(path.name for path in folder.glob("*.mcap"))
    assert [one["message_count"] for one in said["files"]] == [10, 10, 10]
    assert said["files"][1]["starting_time"]["nanoseconds_since_epoch"] == START_NS + 10 * STEP_NS


def test_continued_recording_is_described_as_a_whole(tmp_path: Path) -> None:
    folder = record(tmp_path / "monday")
    record(folder)
    assert topics(folder) == {name: 2 * count for name, count in TOPICS.items()}


def test_folder_without_a_part_is_described_again_when_the_budget_removes_it(tmp_path: Path) -> None:
    old = record(tmp_path / "monday")
    part = min(old.glob("*.mcap")).stat().st_size
    new = record(tmp_path / "tuesday", chunks=2, budget=3 * part + part // 2)
    assert len(list(old.glob("*.mcap"))) < 3
    assert topics(old)["/odometry"] < 10
    assert topics(new) == {"/front": 7, "/odometry": 3}
    record(tmp_path / "wednesday", budget=3 * part + part // 2)
    assert not old.exists(), "the file was left in it"


def test_repair_makes_the_folder_of_a_killed_logger_readable(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "monday")
    last = max(folder.glob("*.mcap"))
    last.write_bytes(last.read_bytes()[:-50])
    assert "has no end" in write_bag_metadata(folder)
    assert not (folder / BAG_METADATA).exists(), "it describes what cannot be read"
    assert main(["recording", "repair", str(folder)]) == 0
    assert topics(folder) == TOPICS
    assert capsys.readouterr().err.count("warning") == 0


def test_file_of_another_program_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = record(tmp_path / "monday")
    (folder / BAG_METADATA).write_text("rosbag2_bagfile_information: {}\n")
    assert main(["recording", "repair", str(folder)]) == 0
    assert "is of another program" in capsys.readouterr().err
    assert (folder / BAG_METADATA).read_text() == "rosbag2_bagfile_information: {}\n"
