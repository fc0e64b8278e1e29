"""A moment of the run: what its clip holds, however damaged, and where it is on the time line."""

import math
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from robbie_mp.messages import CompressedImage, Image, Message, Point, Pose, PoseStamped, Quaternion
from robbie_mp.station.panels import time_line
from robbie_mp.station.panels.time_line import MAX_RESTARTS, MomentBeside, TimeLinePanel, TimePoint
from robbie_mp.station.past.moments import Moment, read_moment
from tests.logs.recording._support.logs import START_NS, LogFile

pytest.importorskip("mcap")
AT_S = START_NS / 1e9 + 10


def grey(value: int) -> Image:
    return Image(height=8, width=8, encoding="mono8", step=8, data=np.full(64, value, np.uint8))


def clip_with(folder: Path, *messages: tuple[float, str, Message]) -> Path:
    with LogFile(folder / "clip.mcap") as log:
        for at_s, topic, message in messages:
            log.add(message, topic, time_ns=START_NS + round(at_s * 1e9))
    return folder / "clip.mcap"


def pose(x: float, turned: float = 1.0) -> PoseStamped:
    return PoseStamped(pose=Pose(position=Point(x=x), orientation=Quaternion(w=1.0, y=turned)))


@pytest.mark.parametrize("wrong", [pose(math.nan), pose(math.inf), pose(0.0, math.nan)])
def test_pose_that_is_no_number_is_no_place_on_the_map(tmp_path: Path, wrong: PoseStamped) -> None:
    moment = read_moment(clip_with(tmp_path, (9, "map_pose", wrong), (9, "eye", grey(5))), AT_S, "x")
    assert list(moment.pictures) == ["eye"]
    assert moment.pose is None


def test_picture_says_how_long_before_the_moment_it_was_taken(tmp_path: Path) -> None:
    clip = clip_with(tmp_path, (1, "dead", grey(5)), (9.5, "eye", grey(5)), (10.5, "late", grey(5)))
    early_s = read_moment(clip, AT_S, "x").early_s
    assert {name: round(one, 1) for name, one in early_s.items()} == {"dead": 9.0, "eye": 0.5, "late": -0.5}


def test_damaged_picture_does_not_hide_the_others(tmp_path: Path) -> None:
    broken = CompressedImage(format="jpeg", data=np.frombuffer(b"\xff\xd8\xff junk", np.uint8))
    odd = Image(height=8, width=8, encoding="mono8", step=8, data=np.zeros(3, np.uint8))
    clip = clip_with(tmp_path, (9, "a", broken), (9, "b", odd), (9, "eye", grey(5)))
    assert "eye" in read_moment(clip, AT_S, "x").pictures


@pytest.fixture
def panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TimeLinePanel:
    monkeypatch.setattr(time_line, "serve_pictures", lambda *_: None)
    station = Mock()
    station.run.output_directory = tmp_path
    station.run.recorder.name = ""
    return TimeLinePanel(station)


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_points_stay_on_the_line_when_the_clock_is_set(panel: TimeLinePanel, step_s: float) -> None:
    panel.begin_s = time.time() - 60
    panel.points = (TimePoint("key", time.time() - step_s, "mark", "text"),)
    line = panel._line("")
    assert line["begin"] <= line["points"][0]["at"] <= line["now"]


def test_restarts_of_eight_hours_are_bounded(panel: TimeLinePanel) -> None:
    now_ns = time.monotonic_ns()
    for number in range(3 * MAX_RESTARTS):
        module: Any = SimpleNamespace(name="body", restarts=number + 1, started_ns=now_ns + number * 10**9)
        reading: Any = SimpleNamespace(modules=[module], at_ns=now_ns)
        panel._station.run.figures.reading = reading
        points = [*panel._restarted()]
    assert len(points) == MAX_RESTARTS
    assert points[-1].time_s > points[0].time_s


def test_only_the_point_that_was_chosen_last_is_read(
    panel: TimeLinePanel, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []

    def read_slowly(_clip: Path, time_s: float, text: str) -> Moment:
        read.append(text)
        return Moment(time_s, text)

    monkeypatch.setattr(time_line, "read_moment", read_slowly)
    beside = MomentBeside.__new__(MomentBeside)
    beside._panel, beside.chosen, beside._result = panel, "2", None
    with panel._one_at_a_time:  # a clip is being read while the operator presses point after point
        points = [TimePoint(str(number), 5.0, "mark", str(number), "clip") for number in range(3)]
        threads = [threading.Thread(target=beside._read, args=(point,)) for point in points]
        for thread in threads:
            thread.start()
    for thread in threads:
        thread.join()
    assert read == ["2"]
    assert isinstance(beside._result, tuple)


def test_name_of_a_camera_is_no_html() -> None:
    from nicegui import Client, ui  # noqa: PLC0415

    hostile = 'x" onerror="alert(1)'
    with Client(ui.page("/nowhere")):
        box = ui.element("div")
        with box:
            time_line.show_image("/moments/1/0", hostile)
        (image,) = box.default_slot.children
        assert image.props == {"src": "/moments/1/0", "alt": hostile}
