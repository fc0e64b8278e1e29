"""The modules in docs/how-to.md and docs/calls.md work as described."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from robbie_mp import GoalAborted, Header, ModuleHarness, SettingError, Time
from robbie_mp.base.state_machine import IllegalTransition, mermaid
from robbie_mp.logs.message_logger import MessageLogger
from robbie_mp.messages import (
    DriveCommand,
    Image,
    LaserScan,
    ModuleState,
    NavigateTo,
    NavigationResult,
    OccupancyGrid,
    TwistStamped,
)
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.run.profile.load import load_profile
from tests.docs._support.pages import block

PROJECT = Path(__file__).parents[2]


def run(*marks: str, page: str = "docs/how-to.md") -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": __name__}
    for mark in marks:
        exec(block(page, mark), names)
    return names


def add_device(monkeypatch: pytest.MonkeyPatch, name: str, **content: object) -> None:
    made = ModuleType(f"hw.{name}")
    vars(made).update(content)
    monkeypatch.setitem(sys.modules, f"hw.{name}", made)


class Imu:
    """Answers as often as it is told, and fails then."""

    def __init__(self, port: str):
        self.answers = [0.5, -0.25]
        self.is_closed = False

    def read(self) -> float:
        if not self.answers:
            raise OSError("the cable is out")
        return self.answers.pop(0)

    def close(self) -> None:
        self.is_closed = True


def test_device_in_a_thread_publishes_and_its_failure_ends_the_module(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    add_device(monkeypatch, "my_imu", MyImu=Imu)
    with ModuleHarness(run("imu")["ImuModule"]) as harness:
        harness.module.thread.join(5.0)
        assert [turn.twist.angular.z for turn in harness.take(TwistStamped)] == [0.5, -0.25]
        with pytest.raises(OSError, match="the cable is out"):
            harness.advance(0.0)
    assert harness.module.imu.is_closed
    assert harness.module.thread not in threading.enumerate()


def test_camera_fills_images_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    class Device:
        def read_into(self, data: Any) -> None:
            data[:] = 7

    add_device(monkeypatch, "my_camera", open_camera=Device)
    with ModuleHarness(run("camera")["Camera"]) as harness:
        harness.advance(0.0)
        (image,) = harness.take(Image)
        assert image.step * image.height == image.data.size
        assert np.unique(image.data).tolist() == [7]


def test_cameras_of_the_pages_copy_no_image(monkeypatch: pytest.MonkeyPatch) -> None:
    class Device:
        def read_into(self, data: Any) -> None:
            data[:] = 7

    add_device(monkeypatch, "my_camera", open_camera=Device)
    for page, mark in (
        ("docs/how-to.md", "camera"),
        ("docs/camera-robot.md", "file modules/camera.py"),
    ):
        camera = run(mark, page=page)["Camera"]
        with ModuleHarness(camera) as harness:
            harness.advance(66 * harness.module.period_s - 0.001)
            assert (harness.bus.copied_loans.count, len(harness.take(Image))) == (0, 66)


def test_opencv_reads_an_image_where_it_lies_and_cannot_change_it() -> None:
    cv2 = pytest.importorskip("cv2")
    with ModuleHarness(run("opencv")["Edges"]) as harness:
        data = np.zeros((48, 64), np.uint8)
        data[10:30, 10:30] = 255
        harness.send(Image(height=48, width=64, step=64, encoding="mono8", data=data.reshape(-1)))
        pixels, status = harness.module.pixels, harness.module.status
    assert int(status.split()[0]) > 40
    assert not pixels.flags.owndata and not pixels.flags.writeable
    with pytest.raises(cv2.error, match=r"readonly|read-only"):
        cv2.rectangle(pixels, (0, 0), (5, 5), 1)


def test_module_does_several_things_periodically() -> None:
    with ModuleHarness(run("every")["Wanderer"]) as harness:
        harness.advance(1.0)
        assert len(harness.take(DriveCommand)) == 21
        assert harness.module.status in ("20 commands", "21 commands")


def test_task_with_a_state_machine_ends_by_a_scan_or_by_its_time_out() -> None:
    names = run("machine")
    near, docking = LaserScan(ranges=np.array([0.1], np.float32)), names["Docking"]
    with ModuleHarness(names["Dock"]) as docked, ModuleHarness(names["Dock"]) as lost:
        docked.advance(0.1)
        docked.send(near)
        lost.advance(31.0)
        lost.send(near)
        assert (docked.module.machine.state, lost.module.machine.state) == (docking.DOCKED, docking.GAVE_UP)
        assert docked.take(DriveCommand)[0].linear_m_per_s > 0.0
        assert lost.take(DriveCommand)[-1].linear_m_per_s == 0.0
    assert lost.module.machine.reason == "timed out after 30 s"
    picture = mermaid(docking.APPROACH, names["TRANSITIONS"], names["TIME_OUTS"])
    assert "APPROACH --> GAVE_UP: after 30 s" in picture
    with pytest.raises(IllegalTransition):
        lost.module.machine.go(docking.DOCKED, "too late")


def test_procedure_drives_from_place_to_place_and_a_restarted_one_to_the_place_it_drove_to() -> None:
    patrol = run("procedure")["Patrol"]
    with ModuleHarness(patrol) as harness:
        harness.advance(0.2)
        harness.end_goal(harness.take(NavigateTo)[0], NavigationResult())
        harness.advance(0.2)
        assert [goal.place for goal in harness.take(NavigateTo)] == ["desk"]
        with ModuleHarness(patrol, restored=harness.checkpoint) as again:
            again.advance(0.2)
            (goal,) = again.take(NavigateTo)
            assert goal.place == "desk"
            again.end_goal(goal, GoalAborted("there is no way"))
            again.advance(0.4)
            assert [goal.place for goal in again.take(NavigateTo)] == ["door"]


def test_encoded_messages() -> None:
    scan = LaserScan(ranges=np.array([1.0, 2.0]))
    with ModuleHarness(run("encoded")["Relay"]) as harness:
        harness.send(scan, topic="laser/front")
        with pytest.raises(NotSubscribed):
            harness.send(scan, topic="radar")
        (relayed,) = harness.published_encoded
    assert (relayed.topic, relayed.data) == ("relayed/front", scan.encode())


def test_topics() -> None:
    with ModuleHarness(run("topics")["TwoLasers"]) as harness:
        harness.send(LaserScan(), topic="laser/front")
        harness.send(LaserScan(), topic="laser/rear")
        assert harness.module.seen == ["front", "any: laser/front", "rear", "any: laser/rear"]


def test_messages_that_belong_together() -> None:
    header = Header(stamp=Time(sec=3))
    with ModuleHarness(run("together")["ColouredScan"]) as harness:
        harness.send(LaserScan(header=header), topic="laser/front")
        harness.send(Image(header=header), topic="camera")
        assert harness.module.status == "1 sets; left over: laser/front 0, camera 0"


def test_safety_stop_example() -> None:
    with ModuleHarness(run("states")["SafetyStop"]) as harness:
        harness.send(ModuleState(module="laser", state="RUNNING"))
        harness.send(ModuleState(module="camera", state="FAILED"))
        assert not harness.take(DriveCommand)
        harness.send(ModuleState(module="laser", state="BACKOFF"))
        assert harness.take(DriveCommand) == [DriveCommand()]


def test_settings() -> None:
    recorder = run("settings", page="docs/settings.md")["Recorder"]
    with pytest.raises(SettingError, match="file"):
        ModuleHarness(recorder)
    with ModuleHarness(recorder, {"file": "scans.bin", "mode": "scans"}) as harness:
        assert harness.module.file == Path("scans.bin").absolute()
        assert harness.module.give_up_after_s is None


def test_profile_that_reduces_latency_is_valid(tmp_path: Path) -> None:
    (tmp_path / "profiles").mkdir()
    (tmp_path / "profiles" / "sooner.yaml").write_text(block("docs/how-to.md", "sooner"))
    profile = load_profile("sooner", tmp_path)
    assert profile.core.scheduling.wake_latency_us == 0
    niceness = {module.name: module.scheduling.nice for module in profile.modules}
    assert niceness == {"mapping": 5, "logger": None}
    assert MessageLogger.nice > 0


def test_late_module_gets_the_newest_map() -> None:
    names = run("latched")
    with ModuleHarness(names["Mapper"]) as harness:
        harness.advance(5.0)
        newest = harness.latched(OccupancyGrid, "map")
        assert newest is not None
        assert newest.data.size == 4
        calibration = harness.latched(names["Calibration"])
        assert calibration is not None
        assert calibration.scale == 1.5


def test_tests_on_the_page_pass() -> None:
    names = run("newest", "pace", "testing")
    names["test_planner_says_what_it_plans_on"]()
    names["test_source_publishes_all_and_ends"]()


SEND_A_SCAN = """
import numpy as np
from robbie_mp import ModuleHarness
from robbie_mp.messages import LaserScan, Point
from tests.docs.test_how_to import run

with ModuleHarness(run("processes")["CornerModule"]) as harness:
    harness.send(LaserScan(ranges=np.array([1.0, 3.0], np.float32)))
    harness.module.found[0].result(timeout=60)
    harness.advance(0.02)
    print([corner.x for corner in harness.take(Point)])
"""


def test_module_publishes_results_of_its_worker_processes(tmp_path: Path) -> None:
    """Run in a separate process, because multiprocessing leaves a process behind while its user lives."""
    (tmp_path / "workers").mkdir()
    (tmp_path / "workers" / "__init__.py").write_text("")
    (tmp_path / "workers" / "my_corners.py").write_text(
        "def find_corner(ranges): return float(ranges.max()), 0.0, 1.0\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", SEND_A_SCAN],
        check=False, capture_output=True, text=True, timeout=100,
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(PROJECT)},
    )  # fmt: skip
    assert ended.stdout == "[3.0]\n", ended.stderr


def test_calls_and_their_tests() -> None:
    names = run("calls", "testing calls", page="docs/calls.md")
    tests = [function for name, function in names.items() if name.startswith("test_")]
    assert len(tests) == 3
    for test in tests:
        test()


def test_goals() -> None:
    names = run("goals", page="docs/calls.md")
    with ModuleHarness(names["Wheels"]) as harness:
        harness.send_goal(names["DriveTo"](distance_m=0.45))
        harness.advance(1.0)
        assert len(harness.take(names["Driven"])) == 5
        assert [arrived.duration_s for arrived in harness.take(names["Arrived"])] == [0.45]
    with ModuleHarness(names["Driver"]) as harness:
        harness.module.go()
        (goal,) = harness.take(names["DriveTo"])
        harness.feed_back(goal, names["Driven"](left_m=1.0))
        assert harness.module.status == "1.0 m left"
        harness.end_goal(goal, names["Arrived"](duration_s=3.0))
        assert harness.module.status == "there in 3.0 s"
