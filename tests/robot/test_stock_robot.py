"""The stock robot's profiles, run as a user runs them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tools.slam_metric import measure, read_table

PROJECT = Path(__file__).parents[2]
DATA = PROJECT.parent / "shared" / "data"
INTEL = DATA / "intel.clf"
COMMAND = [sys.executable, "-c", "import sys; from robbie_mp.cli import main; sys.exit(main())"]

# Whole robots on a busy machine take their time.
pytestmark = [pytest.mark.alone, pytest.mark.timeout(150)]

needs_intel = pytest.mark.skipif(not INTEL.exists(), reason=f"the Intel log is not at {INTEL}")


class StockRobot:
    """Runs profiles of the project, with everything they write in a temporary folder."""

    def __init__(self, folder: Path, workspace: Path = PROJECT) -> None:
        self.output = folder / "out"
        self._workspace = workspace
        self._environment = dict(os.environ, XDG_RUNTIME_DIR=str(folder), PYTHONPATH=str(PROJECT))
        self._process: subprocess.Popen[str] | None = None

    def start(self, *arguments: str, command: str = "run") -> None:
        self._process = subprocess.Popen(
            [*COMMAND, command, *arguments, "--json", "--output", str(self.output)],
            cwd=self._workspace,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def wait(self, timeout_s: float) -> tuple[int, dict[str, dict[str, Any]], str]:
        """Exit code, modules of the summary, standard error."""
        assert self._process is not None
        stdout, stderr = self._process.communicate(timeout=timeout_s)
        summary = json.loads(stdout) if stdout else {"modules": []}
        return self._process.returncode, {module["name"]: module for module in summary["modules"]}, stderr

    def run(self, *arguments: str, timeout_s: float = 120.0) -> tuple[int, dict[str, dict[str, Any]], str]:
        self.start(*arguments)
        return self.wait(timeout_s)

    def play(self, log: Path, *arguments: str) -> tuple[int, dict[str, dict[str, Any]], str]:
        """Play a log; the output is in another folder then."""
        self.output = self.output.with_name(f"{log.stem}-{arguments[0]}")
        self.start(str(log), *arguments, command="play")
        return self.wait(300.0)

    def top(self) -> dict[str, dict[str, Any]]:
        answer = subprocess.run(
            [*COMMAND, "top", "--once", "--json"],
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return {
            module["name"]: module for module in json.loads(answer.stdout or '{"modules": []}')["modules"]
        }

    def attach(self, *arguments: str) -> subprocess.Popen[str]:
        """Start a command that attaches to the run."""
        return subprocess.Popen(
            [*COMMAND, *arguments],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.communicate(timeout=30)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[StockRobot]:
    made = StockRobot(tmp_path)
    yield made
    made.close()


def test_demo_explores_maps_drives_home_and_touches_nothing(robot: StockRobot) -> None:
    code, modules, errors = robot.run("demo", "--set", "exploration.time_limit_s=7")
    assert code == 0, errors
    assert json.loads((robot.output / "base.json").read_text())["collisions"] == 0
    with Image.open(robot.output / "map.png") as picture:
        assert min(picture.size) > 300
    assert modules["mapping"]["handled"] > 100
    assert modules["mapping"]["lost"] == 0
    assert all(module["restarts"] == 0 for module in modules.values())


@needs_intel
@pytest.mark.timeout(450)
def test_intel_log_is_mapped_completely_and_better_than_by_scan_matching(robot: StockRobot) -> None:
    code, modules, errors = robot.run("intel", "--set", f"playback.file={INTEL}", timeout_s=400)
    assert code == 0, errors
    counted = json.loads((robot.output / "mapping.json").read_text())
    assert (counted["scans"], counted["odometry_messages"]) == (910, 14541)
    books = {(entry["type_name"], entry["topic"]): entry for entry in modules["mapping"]["subscriptions"]}
    assert books["sensor_msgs/msg/LaserScan", ""]["delivered"] == 910
    assert books["nav_msgs/msg/Odometry", "odom"]["delivered"] == 14541
    assert modules["mapping"]["dropped"] == modules["mapping"]["lost"] == modules["playback"]["refused"] == 0
    trajectory = read_table(robot.output / "trajectory.txt", 4, "t x y theta")
    score = measure(
        trajectory, read_table(DATA / "intel.relations", 8, "t1 t2 and the pose of t2 seen from t1")
    )
    assert (score.relations_used, score.relations_unmatched) == (2984, 0)
    assert score.translation_mean_m < 0.1


@needs_intel
@pytest.mark.timeout(300)
def test_only_the_killed_mapping_is_restarted_and_its_loss_is_counted(
    robot: StockRobot, tmp_path: Path
) -> None:
    part = tmp_path / "part.clf"
    part.write_text("".join(INTEL.read_text().splitlines(keepends=True)[:4000]))
    robot.start("intel", "--set", f"playback.file={part}")
    deadline = time.monotonic() + 120
    while not (figures := robot.top()) or figures["mapping"]["handled"] < 500:
        assert time.monotonic() < deadline, figures
    os.kill(figures["mapping"]["pid"], signal.SIGKILL)
    code, modules, errors = robot.wait(150)
    assert code == 0, errors
    assert modules["mapping"]["restarts"] == 1
    assert modules["playback"]["restarts"] == modules["core"]["restarts"] == 0
    assert modules["mapping"]["lost"] <= 1
    assert modules["mapping"]["dropped"] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing"], "there is no profile 'nothing'"),
        (["intel"], "CarmenPlayback.file: required"),
        (["intel", "--set", "playback.file=/no/such/log.clf"], "/no/such/log.clf"),
        (["intel", "--set", "playback.fiel=x"], "fiel"),
        (["demo", "--set", "mapping.resolution_m=wide"], "resolution_m"),
        (["demo", "--set", "base.period_s=-1"], "period_s"),
    ],
)
def test_bad_input_is_refused_before_any_process_starts(
    robot: StockRobot, arguments: list[str], said: str
) -> None:
    code, _, errors = robot.run(*arguments)
    assert code == 2
    assert said in errors
    assert "Traceback" not in errors
    assert not robot.output.exists()


def test_broken_line_of_a_log_is_reported_and_can_be_skipped(robot: StockRobot, tmp_path: Path) -> None:
    broken = tmp_path / "broken.clf"
    lines = [f"ODOM {i}.0 0 0 0 0 0 {1000 + i}.0 host {i}.0\n" for i in range(5)]
    lines[2] = "ODOM 1.0 what\n"
    broken.write_text("".join(lines))
    code, _, errors = robot.run("intel", "--set", f"playback.file={broken}")
    assert code == 2
    assert f"{broken}:3:" in errors
    code, modules, errors = robot.run(
        "intel", "--set", f"playback.file={broken}", "--set", "playback.skip_broken=true"
    )
    assert code == 0, errors
    assert modules["mapping"]["handled"] == 5  # four lines and the place of the laser
    assert "1 broken lines" in (robot.output / "log" / "playback.jsonl").read_text()
