"""`robbie plot`: of a recording as text and as a picture; tests/cli/test_live.py has the live one."""

import struct
import subprocess
from pathlib import Path

import pytest

from robbie_mp.attached.views.series import MOST_POINTS, PlotSeries
from robbie_mp.cli import main
from robbie_mp.messages import Odometry, Point, Pose, PoseWithCovariance, String
from tests._support.robot import COMMAND
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile

X = "odom.pose.pose.position.x"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """An odometry whose x goes from 0 to 9.9, and text."""
    path = tmp_path / "run.mcap"
    with LogFile(path) as log:
        for number in range(100):
            place = PoseWithCovariance(pose=Pose(position=Point(x=number / 10, y=5.0)))
            log.add(Odometry(pose=place), "odom", time_ns=START_NS + number * STEP_NS)
            log.add(String(data="hello"), "note.book", time_ns=START_NS + number * STEP_NS)
    return path


def test_recording_is_drawn_as_text(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plot", X, "Odometry.pose.pose.position.y", "--recording", str(recording)]
    assert main(words) == 0
    output, errors = capsys.readouterr()
    assert "\x1b" not in output, "a file gets no colours"
    assert f"{X}  9.9" in output and "Odometry.pose.pose.position.y  5" in output
    assert any("⠤" <= character <= "⣿" for character in output)
    assert "200" in errors


@pytest.mark.slow
def test_recording_is_drawn_as_a_picture(recording: Path, tmp_path: Path) -> None:
    # In a process of its own: matplotlib keeps its fonts open.
    target = tmp_path / "x.png"
    command = [*COMMAND, "plot", X, "--recording", str(recording), "-o", str(target)]
    subprocess.run(command, check=True, timeout=100)
    data = target.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (1200, 720)
    again = subprocess.run(command, check=False, timeout=100, capture_output=True, text=True)
    assert again.returncode == 2
    assert "x.png cannot be written: File exists" in again.stderr
    assert target.read_bytes() == data


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("odom", "'odom' names no field; expected TOPIC.FIELD"),
        ("odm.pose.x", "no message type and no topic is called 'odm'; did you mean 'odom'"),
        ("odom.pose.pose.position.w", "geometry_msgs/msg/Point has no field 'w'"),
        ("odom.pose.pose.position", "is a geometry_msgs/Point; name one of its fields: x, y, z"),
        ("odom.pose.covariance", "is a float64[36]; name one of its elements, such as pose.covariance[0]"),
        ("note.book.data", "data is a string, no number"),
    ],
)
def test_what_cannot_be_drawn_is_reported(
    recording: Path, name: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", name, "--recording", str(recording)]) == 1
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "x.png"], "-o needs --recording"),
        ([], "robbie plot needs a terminal; use --once"),
    ],
)
def test_wrong_use_is_reported(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", X, *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("library", "words"), [("plotext", []), ("matplotlib.figure", ["-o", "x.png"])])
def test_missing_library_is_reported_with_advice(
    library: str,
    words: list[str],
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(__import__("sys").modules, library, None)
    assert main(["plot", X, "--recording", str(recording), *words]) == 1
    assert "`pip install matplotlib 'plotext<6'`" in capsys.readouterr().err


def test_long_series_is_thinned_out_evenly() -> None:
    series = PlotSeries("x")
    for number in range(10 * MOST_POINTS):
        series.add(float(number), -float(number))
    assert MOST_POINTS / 2 <= len(series.values) <= MOST_POINTS
    steps = {after - before for before, after in zip(series.times_s, series.times_s[1:], strict=False)}
    assert len(steps) == 1
    series.forget_before(5.0 * MOST_POINTS)
    assert series.times_s[0] >= 5.0 * MOST_POINTS and len(series.times_s) == len(series.values)


def test_infinite_values_are_not_drawn() -> None:
    series = PlotSeries("x")
    for value in (1.0, float("inf"), float("nan"), 2.0):
        series.add(0.0, value)
    assert series.values == [1.0, 2.0]
