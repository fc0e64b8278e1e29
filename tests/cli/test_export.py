"""`robbie export`, `diff` and the imports."""

import csv
import json
import os
import pty
import re
import select
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp import Array, Message, float64, int64
from robbie_mp.cli import export, main
from robbie_mp.cli.file_names import file_names
from robbie_mp.cli.log_files import progress_bar
from robbie_mp.logs.recording.reader import LogChannel
from robbie_mp.messages import Odometry, TFMessage, TransformStamped, schema_text
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile, scan, write_log
from tests.logs.recording.test_imports import CARMEN, write_bag


class Tricky(Message, name="team_msgs/msg/Tricky", version=1):
    file: float64


class Long(Message, name="team_msgs/msg/Long", version=1):
    rows: Array[int64, Literal[70]]
    short: Array[int64, Literal[2]]


class Go(Message, name="team_msgs/msg/Go", version=1):
    """Says something by being sent."""


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_log(tmp_path / "a.mcap", 30)


def test_csv_has_a_line_for_each_message_and_a_column_for_each_number(log: Path) -> None:
    assert main(["export", str(log), "out"]) == 0
    tables = {"laser_front.csv", "laser_front.arrays", "odom.csv", "LaserScan.csv", "LaserScan.arrays"}
    assert {path.name for path in Path("out").iterdir()} == tables
    with Path("out/laser_front.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    assert list(rows[0])[:5] == [
        "time_ns", "sequence", "header.stamp.sec [s]", "header.stamp.nanosec", "header.frame_id"]  # fmt: skip
    assert (rows[1]["time_ns"], rows[1]["sequence"]) == (str(START_NS + 3 * STEP_NS), "4")
    with Path("out/odom.csv").open() as file:
        assert [row["child_frame_id"] for row in csv.DictReader(file)][:2] == ["base 1", "base 4"]


def test_arrays_of_tables_are_numpy_files(log: Path) -> None:
    with LogFile(Path("b.mcap")) as file:
        for number in range(4):
            file.add(scan(number, rays=number), "scan", time_ns=START_NS + number)
            file.add(
                Long(rows=np.arange(number, number + 70, dtype=np.int64), short=np.array([1, number])), "long"
            )
            file.add(TFMessage(transforms=[TransformStamped(child_frame_id=f"f{number}")] * number), "tf")
    assert main(["export", "b.mcap", "out"]) == 0
    scans = columns_of(Path("out/scan.csv"))
    ranges = np.load("out/scan.arrays/ranges.npy", mmap_mode="r")
    lengths = np.array(scans["ranges.lengths"], int)
    assert lengths.tolist() == [0, 1, 2, 3] and ranges.dtype == np.float32
    parts = np.split(ranges, np.cumsum(lengths)[:-1])
    assert [part.tolist() for part in parts] == [[], [1], [2, 2], [3, 3, 3]]
    assert np.load("out/scan.arrays/intensities.npy").shape == (0,)
    assert np.load("out/long.arrays/rows.npy")[2].tolist() == list(range(2, 72))
    long = columns_of(Path("out/long.csv"))
    assert long["short[1]"] == ["0", "1", "2", "3"] and list(long) == ["time_ns", "sequence", *long][-4:]
    transforms = columns_of(Path("out/tf.csv"))["transforms"]
    assert [one["child_frame_id"] for one in json.loads(transforms[2])] == ["f2", "f2"]


def columns_of(path: Path) -> dict[str, list[str]]:
    with path.open() as file:
        names, *rows = csv.reader(file)
    return {name: [row[index] for row in rows] for index, name in enumerate(names)}


@pytest.mark.parametrize("form", ["--csv", "--npz", "--parquet", "--ply", "--trajectory=tum"])
def test_size_of_an_export_is_estimated(log: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with LogFile(Path("b.mcap")) as file:
        for number in range(200):
            file.add(scan(number, rays=500), "scan", time_ns=START_NS + number)
            file.add(Odometry(), "odom", time_ns=START_NS + number)
    found: dict[LogChannel, int] = {}
    monkeypatch.setattr(export, "is_wanted", lambda _folder, sizes, yes: found.update(sizes) or True)
    assert main(["export", "b.mcap", "out", form]) == 0
    written = sum(path.stat().st_size for path in Path("out").rglob("*") if path.is_file())
    assert sum(found.values()) == pytest.approx(written, rel=0.1)


def test_large_export_is_refused_without_a_terminal_and_written_with_yes(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robbie_mp.cli.export_size.ASKED_BYTES", 100)
    assert main(["export", str(log), "out"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "out will take about" in error and "; --yes writes it" in error
    assert "laser/front" in error and "are free" in error and not Path("out").exists()
    assert main(["export", str(log), "out", "--yes"]) == 0
    assert Path("out/odom.csv").exists()


@pytest.mark.parametrize(("answer", "is_written"), [("y", True), ("n", False), ("", False)])
def test_large_export_is_asked_for_on_a_terminal(
    log: Path, monkeypatch: pytest.MonkeyPatch, answer: str, *, is_written: bool
) -> None:
    monkeypatch.setattr("robbie_mp.cli.export_size.ASKED_BYTES", 100)
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "r+b", buffering=0), os.fdopen(controller, "r+b", buffering=0) as user:
        with open(terminal, "w", closefd=False) as stderr, open(terminal, closefd=False) as stdin:
            monkeypatch.setattr("sys.stderr", stderr)
            monkeypatch.setattr("sys.stdin", stdin)
            user.write(f"{answer}\n".encode())
            assert main(["export", str(log), "out"]) == (0 if is_written else 1)
        shown = b""
        while b"Write it? [y/N]" not in shown:
            shown += os.read(controller, 10_000)
    assert Path("out").exists() == is_written


def test_messages_without_fields_are_exported_with_their_times(log: Path) -> None:
    with LogFile(Path("b.mcap")) as file:
        for number in range(3):
            file.add(Go(), "go", time_ns=START_NS + number)
    for form, out in (("--csv", "a"), ("--npz", "b"), ("--rosbag2", "c")):
        assert main(["export", "b.mcap", out, form]) == 0
    lines = ["time_ns,sequence", *(f"{START_NS + number},{number + 1}" for number in range(3))]
    assert Path("a/go.csv").read_text().splitlines() == lines
    with np.load("b/go.npz") as arrays:
        assert arrays["time_ns"].tolist() == [START_NS, START_NS + 1, START_NS + 2]
    assert main(["diff", "b.mcap", "c"]) == 0


def test_numpy_files_have_the_same_values(log: Path) -> None:
    with LogFile(Path("b.mcap")) as file:
        for number in range(3):
            file.add(scan(number, rays=number), "scan", time_ns=START_NS + number)
            file.add(TFMessage(transforms=[TransformStamped(child_frame_id=f"f{number}")] * number), "tf")
            file.add(Tricky(file=number / 2), "tricky")
    assert main(["export", "b.mcap", "out", "--npz"]) == 0
    with np.load("out/scan.npz") as scans:
        assert scans["time_ns"].tolist() == [START_NS, START_NS + 1, START_NS + 2]
        assert scans["ranges"].dtype == np.float32 and scans["ranges"].tolist() == [1, 2, 2]
        assert scans["ranges.lengths"].tolist() == [0, 1, 2]
        assert scans["header.frame_id"].tolist() == ["laser"] * 3
    with np.load("out/tf.npz") as transforms:
        assert transforms["transforms.child_frame_id"].tolist() == ["f1", "f2", "f2"]
        assert transforms["transforms.lengths"].tolist() == [0, 1, 2]
        assert transforms["transforms.transform.rotation.w"].tolist() == [1, 1, 1]
    with np.load("out/tricky.npz") as tricky:
        assert tricky["file"].tolist() == [0, 0.5, 1]
    with LogFile(Path("c.mcap")) as file:
        file.channel(Tricky.type_name, schema_text(Tricky), 1, "none", "")
    assert main(["export", "c.mcap", "out", "--npz"]) == 0
    with np.load("out/none.npz") as none:
        assert none["file"].shape == (0,)


def test_arrays_of_fixed_length_are_rows(log: Path) -> None:
    assert main(["export", str(log), "out", "--npz", "--topics", "odo*"]) == 0
    assert [path.name for path in Path("out").iterdir()] == ["odom.npz"]
    with np.load("out/odom.npz") as odometry:
        assert odometry["pose.covariance"].shape == (10, 36)


def test_pattern_that_matches_nothing_is_a_warning(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(log), "out", "--topics", "odom", "lidar"]) == 0
    error = capsys.readouterr().err
    assert error == "warning: no topic matches 'lidar'; there are: LaserScan, laser/front, odom\n"
    assert main(["diff", str(log), str(log), "--topics", "lidar"]) == 0
    assert "no topic matches 'lidar'" in capsys.readouterr().err


def test_unreadable_messages_are_skipped_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with LogFile(Path("a.mcap")) as file:
        tricky = file.channel(Tricky.type_name, schema_text(Tricky), 1, "tricky", "")
        file.add_bytes(tricky, b"\0\1\0\0short", 1)
        file.add(Tricky(file=2), "tricky", sender="")
        odd = file.channel("team_msgs/msg/Odd", "wstring x", 1, "odd", "")
        file.add_bytes(odd, b"", 1)
    assert main(["export", "a.mcap", "out"]) == 1
    error = capsys.readouterr().err
    assert "left out 1: " in error and "wstring is not supported" in error
    assert "left out 1: messages of 'tricky' that do not encode their type" in error
    assert len(Path("out/tricky.csv").read_text().splitlines()) == 2


def test_diff_prints_how_channels_differ(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diff", str(log), str(log)]) == 0
    assert "equal: 30 messages" in capsys.readouterr().out
    with LogFile(Path("b.mcap")) as file:
        for number in range(0, 30, 3):
            if number != 12:
                time_ns = START_NS + number * STEP_NS
                file.add(scan(number + (number == 6), time_ns), "laser/front", "laser", time_ns=time_ns)
    assert main(["diff", str(log), "b.mcap", "--topics", "laser/*"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["laser/front", "sensor_msgs/msg/LaserScan", "laser", "8", "1", "1", "0"]
    assert lines[2] == "laser/front: message 2: ranges[0]: 6.0 in A, 7.0 in B"
    assert main(["diff", str(log), "b.mcap", "--json"]) == 1
    found = {one["topic"]: one for one in json.loads(capsys.readouterr().out)}
    assert found["odom"]["only_in_a"] == 10 and found["odom"]["first_difference"] is None
    assert found["laser/front"]["first_difference"] == {
        "index": 2,
        "time_ns": START_NS + 6 * STEP_NS,
        "field": "ranges[0]",
        "a": "6.0",
        "b": "7.0",
    }


def test_diff_leaves_out_channels_and_ignores_senders(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogFile(Path("b.mcap")) as file:
        for number in range(0, 30, 3):
            time_ns = START_NS + number * STEP_NS
            file.add(scan(number, time_ns), "laser/front", "playback", time_ns=time_ns)
    options = ["--exclude", "odom", "LaserScan"]
    assert main(["diff", str(log), "b.mcap", *options]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert main(["diff", str(log), "b.mcap", *options, "--ignore-sender"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["laser/front", "sensor_msgs/msg/LaserScan", "any", "10", "0", "0", "0"]
    assert main(["diff", str(log), str(log), "--exclude", "lidar"]) == 0
    assert "no topic matches 'lidar'" in capsys.readouterr().err


def test_intact_parts_of_damaged_logs_are_compared_and_exported(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("cut.mcap").write_bytes(log.read_bytes()[:-6000])
    assert main(["diff", str(log), "cut.mcap"]) == 1
    assert "only the intact part was compared" in capsys.readouterr().err
    assert main(["export", "cut.mcap", "out"]) == 1
    assert "left out 1: what is damaged: cut.mcap: byte" in capsys.readouterr().err


def test_imports_report_their_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.clf").write_text(CARMEN)
    assert main(["import-carmen", "a.clf", "a.mcap"]) == 1
    said = capsys.readouterr()
    assert said.out == "a.mcap: read 5 messages: 4 used, 1 left out\n" and said.err.startswith(
        "warning: left out 1: broken FLASER lines; the first is line 4: FLASER must state"
    )
    assert main(["import-carmen", "a.clf", "b.mcap", "--strict"]) != 0
    assert "broken FLASER lines; the first is line 4" in capsys.readouterr().err
    write_bag(tmp_path, "ROS 1")
    assert main(["import-rosbag", "a.bag", "b.mcap"]) == 0
    assert capsys.readouterr().out == "b.mcap: read 3 messages: 3 used, 0 left out\n"
    assert main(["info", "b.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["messages"] == 3


STYLE = re.compile(rb"\x1b\[[0-9;]*m")
LONG_COMMANDS = {
    "export": "export log.mcap out",
    "export --rosbag2": "export log.mcap out --rosbag2",
    "info of a log": "info log.mcap",
    "info of a bag": "info a.bag",
    "info of a CARMEN log": "info a.clf",
    "import-carmen": "import-carmen a.clf b.mcap",
    "import-rosbag": "import-rosbag a.bag b.mcap",
    "recording repair": "recording repair log.mcap",
    "diff": "diff log.mcap log.mcap",
    "recording cut": "recording cut log.mcap -o b.mcap --to 1",
}


@pytest.mark.parametrize("name", LONG_COMMANDS)
def test_long_commands_show_their_progress_on_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("robbie_mp.cli.log_files.SHOWN_AFTER_S", 0.0)
    monkeypatch.setattr("robbie_mp.cli.log_files.Timer", AtOnce)
    write_log(tmp_path / "log.mcap", 30)
    Path("a.clf").write_text(CARMEN)
    write_bag(tmp_path, "ROS 1")
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "w") as stderr, os.fdopen(controller, "rb"):
        monkeypatch.setattr("sys.stderr", stderr)
        assert main(LONG_COMMANDS[name].split()) in (0, 1)
        shown = b""
        while b"\xe2\x94\x81" not in shown:  # of the bar; a terminal passes its text on in parts
            shown += os.read(controller, 10_000)


class AtOnce:
    """A timer that ends when it starts."""

    def __init__(self, _seconds: float, action: Callable[[], None]):
        self.start = action

    def cancel(self) -> None:
        return

    def join(self) -> None:
        return


def test_progress_bar_says_how_long_the_rest_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robbie_mp.cli.log_files.SHOWN_AFTER_S", 0.0)
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "w") as stderr, os.fdopen(controller, "rb"):
        monkeypatch.setattr("sys.stderr", stderr)
        shown, done = b"", 0
        with progress_bar("reading") as progress:
            while not re.search(rb"\d+% \d:\d\d:\d\d", STYLE.sub(b"", shown)):
                time.sleep(0.05)
                done += 1
                progress(done, 10_000)
                if select.select([controller], [], [], 0)[0]:
                    shown = shown[-500:] + os.read(controller, 10_000)


def test_quick_command_shows_no_progress_bar(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robbie_mp.cli.log_files.SHOWN_AFTER_S", 1000.0)
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "w") as stderr, os.fdopen(controller, "rb"):
        monkeypatch.setattr("sys.stderr", stderr)
        assert main(["export", str(log), "out"]) == 0
        assert not select.select([controller], [], [], 0)[0]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["export", "none.mcap", "out"], "none.mcap cannot be read: No such file or directory"),
        (["export", "a.mcap", "a.mcap"], "cannot be written: File exists"),
        (["diff", "a.mcap", "none.mcap"], "none.mcap cannot be read: No such file or directory"),
        (["import-carmen", "none.clf", "b.mcap"], "none.clf cannot be read: No such file or directory"),
        (["import-carmen", "good.clf", "a.mcap"], "a.mcap cannot be written: File exists"),
        (["import-rosbag", "a.clf", "b.mcap"], "a.clf cannot be read as a bag of ROS"),
    ],
)
def test_bad_input_is_a_one_line_error(
    log: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], what: str
) -> None:
    Path("a.clf").write_text(CARMEN)
    Path("good.clf").write_text("")
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert what in error and error.count("\n") == 1
    assert not Path("b.mcap").exists()


def channels(*topics: str, type_name: str = "std_msgs/msg/Empty") -> list[LogChannel]:
    return [LogChannel(number, type_name, 1, topic, "m", "") for number, topic in enumerate(topics)]


LONG = "a" * 300


@pytest.mark.parametrize(
    ("topics", "names"),
    [
        (["odom", "red/odom"], ["odom", "red_odom"]),
        (["odom", "Odom", "ODOM"], ["odom", "Odom-Empty", "ODOM-Empty-m"]),
        (["a b", "a_b", "a/b", "a-b"], ["a_b", "a_b-Empty", "a_b-Empty-m", "a-b"]),
        (["..", ".", "con", "nul.x", "com7", "a."], ["_._", "_", "_con", "_nul.x", "_com7", "a_"]),
        (["q-Empty-m-1", "q", "q", "q", "q-Empty-m-4"], None),
    ],
)
def test_files_of_topics_have_names_that_every_file_system_takes(
    topics: list[str], names: list[str] | None
) -> None:
    found = list(file_names(channels(*topics)).values())
    assert names is None or found == names
    assert len({name.casefold() for name in found}) == len(topics)


@given(st.lists(st.text(max_size=400) | st.sampled_from([LONG + "b", LONG + "c", LONG.upper()]), max_size=12))
def test_names_of_files_are_bounded_and_differ(topics: list[str]) -> None:
    found = list(file_names(channels(*topics)).values())
    assert len({name.casefold() for name in found}) == len(topics)
    for name in found:
        assert 0 < len(name.encode()) <= 201
        assert name not in (".", "..") and not set(name) & set('/\\:*?"<>|\0')


def test_topic_of_300_characters_is_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with LogFile(tmp_path / "long.mcap") as log:
        for topic in (f"{LONG}1", f"{LONG}2", "odom"):
            log.add(scan(1), topic)
    assert main(["export", "long.mcap", "out"]) == 0
    written = sorted(path.name for path in Path("out").iterdir())
    assert len(written) == 6 and written[-2:] == ["odom.arrays", "odom.csv"]
    assert all(len(name) <= 210 for name in written)
