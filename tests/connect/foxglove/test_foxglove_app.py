"""What the layers of the app make of every type, of a log and of a live robot: its own packages, from npm."""

import json
import logging
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.connect.foxglove import door
from robbie_mp.connect.foxglove.module import FoxgloveServer
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.recorder import Recorder
from robbie_mp.messages import LaserScan, Message, Odometry, schema_text, stock_registry
from robbie_robots.modules.rescue import messages as rescue_messages
from robbie_robots.modules.rescue import team_messages
from tests._support.robot import wait_until
from tests.logs.recording._support.recording import START_NS, writer

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).parent / "_support" / "app.cjs"
PACKAGES = [
    "@foxglove/message-definition@0.4.0",
    "@foxglove/rosmsg@5.0.5",
    "@foxglove/rosmsg-msgs-common@3.2.3",
    "@foxglove/rosmsg2-serialization@3.1.0",
    "@foxglove/ws-protocol@0.8.0",
    "@mcap/core@2.2.2",
    "@mcap/nodejs@1.0.2",
    "@mcap/support@1.1.0",
    "ws@8.18.3",
]
INSTALL_LIMIT_S = 300.0
OTHERS = {"sensor_msgs/BatteryState", "sensor_msgs/NavSatStatus"}
"""The app has them as ROS 2 Humble had them; ours are those of Jazzy."""


class Clock:
    """The clock of a run that is played."""

    has_begun = True
    jumps = 0

    def now_ns(self) -> int:
        return 1_700_000_000_000_000_000

    def close(self) -> None:
        pass


@pytest.fixture(scope="session")
def packages() -> Path:
    """A folder with the app's packages, which stays for later runs."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("no node and npm here")
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(base) / "robbie-tests" / "foxglove-app"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "package.json").touch()
    wanted = "\n".join(PACKAGES)
    done = folder / "installed"
    if not done.exists() or done.read_text() != wanted:
        (folder / "package.json").write_text("{}")
        options = ["--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder)]
        ended = subprocess.run(
            [npm, "install", *options, *PACKAGES],
            check=False,
            capture_output=True,
            text=True,
            timeout=INSTALL_LIMIT_S,
        )
        if ended.returncode:
            pytest.skip(f"npm cannot install the app's packages: {ended.stderr:.300}")
        done.write_text(wanted)
    return folder / "node_modules"


def types() -> list[type[Message]]:
    own = [*vars(rescue_messages).values(), *vars(team_messages).values()]
    return [*stock_registry(), *(one for one in own if hasattr(one, "type_name"))]


def write_log(folder: Path) -> Path:
    """A log whose latched topic was published before the recording, and three times in it."""
    limits = BufferLimits(1 << 10, 1 << 12, close_after_s=0.01)
    recorder = Recorder(lambda _dropped: writer(folder), limits, logging.getLogger(__name__))
    channel = recorder.channel(
        ChannelKey(Odometry.type_name, 1, "map", "mapper"), schema_text(Odometry), is_latched=True
    )
    recorder.carry(channel, 1, START_NS, Odometry().encode())
    for number in range(2, 5):
        recorder.record(channel, number, START_NS + number, Odometry().encode())
    recorder.close()
    return next(folder.glob("*.mcap"))


@pytest.fixture(scope="module")
def seen(packages: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the app's layers say about all of it."""
    folder, patch = tmp_path_factory.mktemp("app"), pytest.MonkeyPatch()
    rows = [[one.type_name, schema_text(one), one().encode().hex()] for one in types()]
    (folder / "types.json").write_text(json.dumps(rows))
    log = write_log(folder / "log")
    around = replace(BridgeRun.of("", "foxglove", ""), has_own_clock=True)
    patch.setattr(BridgeRun, "of", lambda *_: around)
    patch.setattr(door, "WRONG_TOKEN_PAUSE_S", 0.0)
    with ModuleHarness(FoxgloveServer, {"port": 0}) as harness, patch.context() as clock:
        clock.setattr(harness.module, "_run_clock", Clock())
        link = harness.module.link
        arguments = [folder / "types.json", log, link, f"{link}x"]
        app = subprocess.Popen(
            ["node", PROGRAM, *map(str, arguments)],
            env={**os.environ, "NODE_PATH": str(packages)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            wait_until(serve(harness, app))
            out, errors = app.communicate()
        finally:
            app.kill()
            app.wait()
            clock.undo()
    patch.undo()
    assert app.returncode == 0, errors
    found: dict[str, Any] = json.loads(out)
    return found


def serve(harness: ModuleHarness[FoxgloveServer], app: "subprocess.Popen[str]") -> Callable[[], bool]:
    """Let the robot's time pass until the app has ended."""

    def step() -> bool:
        harness.send(LaserScan(ranges=np.array([1.0, 2.5], np.float32)), topic="scan")
        harness.advance(0.05)
        return app.poll() is not None

    return step


def test_the_app_reads_and_writes_every_type(seen: dict[str, Any]) -> None:
    assert seen["unreadable"] == {}
    assert seen["changed"] == []


def test_the_app_knows_the_types_of_ros_as_they_are(seen: dict[str, Any]) -> None:
    assert {name for name, is_equal in seen["known"].items() if not is_equal} == OTHERS
    assert seen["known"]["geometry_msgs/Quaternion"]


def test_the_app_counts_the_messages_of_a_latched_topic(seen: dict[str, Any]) -> None:
    assert seen["log"] == {"/map": 3}


def test_the_app_meets_a_robot_of_ros_with_its_own_time(seen: dict[str, Any]) -> None:
    live = seen["live"]
    assert live["metadata"]["ROS_DISTRO"] == "jazzy"
    assert live["ranges"] == [1.0, 2.5]
    assert live["time"] == str(Clock().now_ns())


def test_the_app_is_told_why_it_is_refused(seen: dict[str, Any]) -> None:
    assert seen["refused"] == door.WRONG_TOKEN
