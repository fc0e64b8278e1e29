"""`robbie recording cut`, `filter` and `merge`, compared with what the library mcap reads."""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from robbie_mp.cli import main
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import Split
from robbie_mp.messages import LaserScan, schema_text
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile, scan, write_log
from tests.logs.recording._support.recording import CHANNELS, chunk_of, writer

CUT = ["recording", "cut"]


def content(path: Path) -> list[tuple[str, str, int, int, bytes]]:
    """Topic, sender, sequence, time and bytes of all messages, as the library reads them."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            (
                channel.topic,
                channel.metadata.get("robbie_sender", ""),
                message.sequence,
                message.log_time,
                message.data,
            )
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def info(path: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    capsys.readouterr()
    assert main(["info", str(path), "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["is_complete"]
    assert told["messages"] == len(content(path)) == sum(one["messages"] for one in told["channels"])
    return told


def logged_counts(path: Path) -> dict[str, list[int]]:
    """Messages recorded and dropped, by topic and sender, as the last record of counts says."""
    with path.open("rb") as file:
        found = [one.metadata for one in make_reader(file).iter_metadata() if one.name == "robbie_counts"]
    (record,) = found
    rows = json.loads(record["channels"])
    return {f"{row['topic']} {row['sender']}": [row["recorded"], row["dropped"]] for row in rows}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Three parts of a recording; the logger has dropped 5 messages of the spare laser."""
    dropped: dict[ChannelKey, int] = {}
    made = writer(tmp_path / "monday", Compression.ZSTD, split=Split(seconds=0.095), dropped=dropped)
    for first in range(0, 30, 5):
        if first == 25:
            dropped[CHANNELS[3].key] = 5
        made.write(chunk_of(range(first, first + 5)), CHANNELS)
    made.close()
    return tmp_path / "monday"


def all_of(folder: Path) -> list[tuple[str, str, int, int, bytes]]:
    return [one for part in sorted(folder.glob("*.mcap")) for one in content(part)]


def test_cut_has_exactly_the_messages_of_a_time(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    every = all_of(recording)
    start_ns = every[0][3]
    target = tmp_path / "cut.mcap"
    assert main([*CUT, str(recording), "--from", "0.02", "--to", "0.05", "-o", str(target)]) == 0
    assert capsys.readouterr().out == f"{target}: 3 of 30 messages\n"
    expected = [one for one in every if start_ns + 20_000_000 <= one[3] < start_ns + 50_000_000]
    assert content(target) == expected
    told = info(target, capsys)
    assert (told["run"]["run_id"], told["run"]["started_ns"]) == ("12ab", expected[0][3])
    assert all(counts[1] == 0 for counts in logged_counts(target).values()), "dropped in another part"
    late = tmp_path / "late.mcap"
    assert main([*CUT, str(recording), "--from", "2023-11-14T22:13:20.25Z", "-o", str(late)]) == 0
    assert content(late) == every[25:]
    assert logged_counts(late)["front spare"] == [2, 5]
    assert info(late, capsys)["channels"][-1]["dropped"] in (0, 5)


def test_filter_takes_types_and_topics_and_keeps_the_books(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "lasers.mcap"
    assert main(["recording", "filter", str(recording), "--topic", "/fro*", "-o", str(target)]) == 0
    assert content(target) == [one for one in all_of(recording) if one[0] == "/front"]
    assert logged_counts(target) == {"front laser": [10, 0], "front spare": [10, 5]}
    dropped = {one["sender"]: one["dropped"] for one in info(target, capsys)["channels"]}
    assert dropped == {"laser": 0, "spare": 5}
    rest = tmp_path / "rest.mcap"
    assert main(["recording", "filter", str(recording), "--not", "LaserScan", "-o", str(rest)]) == 0
    assert content(rest) == [one for one in all_of(recording) if one[0] == "/odometry"]
    none = tmp_path / "none.mcap"
    assert main(["recording", "filter", str(recording), "--type", "Imu", "-o", str(none)]) == 1
    said = capsys.readouterr().err
    assert "type 'Imu', topic '*': no messages in" in said
    assert "the new recording is empty" in said


def test_merge_orders_by_time_and_keeps_different_definitions_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = write_log(tmp_path / "a.mcap", 9)
    second = tmp_path / "b.mcap"
    with LogFile(second, chunk_size=1000) as log:
        log.writer.add_metadata("robbie_run", {"run_id": "ffff", "profile": "demo"})
        log.writer.add_attachment(1, 2, "note", "text/plain", b"hello")
        for number in range(4):
            log.add(scan(number), "laser/front", "laser", time_ns=START_NS + number * STEP_NS + 7)
        other = log.channel("nav_msgs/msg/Odometry", "uint8 x", 1, "odom", "base")
        log.add_bytes(other, b"\0\1\0\0\5", START_NS + 3)
    target = tmp_path / "both.mcap"
    assert main(["recording", "merge", str(first), str(second), "-o", str(target)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{target}: 14 of 14 messages\n"
    assert "the recordings are of different runs" in said.err
    assert "topic /odom has 2 definitions, each in its own channel: nav_msgs/msg/Odometry" in said.err
    merged = content(target)
    one, two = content(first), content(second)
    assert sorted(merged) == sorted([*one, *two])
    for log_content in (one, two):
        assert [item for item in merged if item in log_content] == log_content, "not in their old order"
    assert [item[3] - START_NS for item in merged][:4] == [0, 7, STEP_NS, STEP_NS + 7]
    told = info(target, capsys)
    topics = sorted((channel["topic"], channel["messages"]) for channel in told["channels"])
    assert topics == [("", 3), ("laser/front", 7), ("odom", 1), ("odom", 3)]
    with target.open("rb") as file:
        reader = make_reader(file)
        assert [one.data for one in reader.iter_attachments()] == [b"hello"]
        records = [one for one in reader.iter_metadata() if one.name == "robbie_run"]
        assert [one.metadata["run_id"] for one in records] == ["0123abcd", "ffff"]


def test_parts_of_a_log_can_be_merged_into_one_file(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "whole.mcap"
    assert main(["recording", "merge", str(recording), "-o", str(target)]) == 0
    assert capsys.readouterr().err == ""
    assert content(target) == all_of(recording)
    assert logged_counts(target)["front spare"] == [10, 5]
    assert main(["diff", str(recording), str(target)]) == 0


def test_nothing_is_overwritten_and_no_folder_of_parts_is_spoilt(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "there.mcap"
    target.write_text("mine")
    assert main([*CUT, str(recording), "-o", str(target)]) == 2
    assert target.read_text() == "mine"
    assert "cannot be written: File exists" in capsys.readouterr().err
    inside = recording / "cut.mcap"
    assert main(["recording", "filter", str(recording), "-o", str(inside)]) == 2
    assert "would become a part of" in capsys.readouterr().err
    assert not inside.exists()


def test_damaged_log_gives_what_is_intact_with_a_warning(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last = max(recording.glob("*.mcap"))
    last.write_bytes(last.read_bytes()[:-100])
    target = tmp_path / "intact.mcap"
    assert main([*CUT, str(recording), "-o", str(target)]) == 0
    assert "only the intact part was copied" in capsys.readouterr().err
    assert content(target) == all_of_intact(recording)


def all_of_intact(folder: Path) -> list[tuple[str, str, int, int, bytes]]:
    return [*all_of_parts(sorted(folder.glob("*.mcap"))[:-1]), *_tail(folder)]


def all_of_parts(parts: list[Path]) -> list[tuple[str, str, int, int, bytes]]:
    return [one for part in parts for one in content(part)]


def _tail(folder: Path) -> list[tuple[str, str, int, int, bytes]]:
    target = folder.parent / "repaired.mcap"
    assert main(["recording", "repair", str(max(folder.glob("*.mcap"))), "-o", str(target)]) == 0
    return content(target)


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    peaks = []
    for megabytes in (4, 32):
        source = tmp_path / f"{megabytes}.mcap"
        with LogFile(source, chunk_size=1 << 20) as log:
            channel = log.channel(LaserScan.type_name, schema_text(LaserScan), 1, "front", "laser")
            for number in range(megabytes * 4):
                log.add_bytes(channel, bytes(1 << 18), START_NS + number)
        tracemalloc.start()
        assert (
            main(["recording", "merge", str(source), str(source), "-o", str(tmp_path / f"new{megabytes}")])
            == 0
        )
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--from", "soon"], "expected a time after the beginning, such as 1min30s, or one"),
        (["--from", "2026-11-22T14:30:00"], "expected a time after the beginning, such as 1min30s, or one"),
        (["--from", "-1"], "expected 0 s to 1e+09 s; got -1"),
        ([], "the following arguments are required: -o/--output"),
    ],
)
def test_bad_usage_is_explained(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*CUT, "log.mcap", *words, *(["-o", "x"] if words else [])])
    assert end.value.code == 2
    assert said in capsys.readouterr().err
