"""A module that runs but does not do its work is DEGRADED: one line begins it, and one ends it."""

import signal
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.run.supervisor.health_watch import LASTING_S, LOOK_S
from tests._support.robot import Ended, Robot, wait_until

MODULES = """
import time
from pathlib import Path

import numpy as np

from robbie_mp import Module
from robbie_mp.messages import Image


class Source(Module):
    period_s = 0.01

    def tick(self):
        if not (self.output_directory / "quiet").exists():
            self.publish(Image(data=np.zeros(1000, np.uint8)))


class Slow(Module):
    def setup(self):
        self.subscribe(Image, self.on_image)

    def on_image(self, _image):
        time.sleep(0.05)


class Hoarder(Module):
    def setup(self):
        self.kept = []
        self.subscribe(Image, self.on_image)

    def on_image(self, image):
        self.kept.append(image.data)


class Late(Module):
    period_s = 0.1

    def tick(self):
        if not (self.output_directory / "quiet").exists():
            time.sleep(0.25)


class Tired(Module):
    period_s = 0.02

    def tick(self):
        self.degraded = "" if (self.output_directory / "quiet").exists() else "100% tired"
"""
QUEUE = "queue: {messages: 20}"
LASER = """
modules:
  laser:
    class: robbie_robots.modules.devices.hokuyo:HokuyoLaserRangeFinder
    settings: {port: /dev/no-such-laser}
"""


def degraded(robot: Robot, name: str) -> dict[str, dict[str, Any]]:
    return robot.until(lambda top: bool(top[name]["health"]) and top[name]["state"] == "RUNNING")


def profile(name: str, more: str = "") -> str:
    return f"modules:\n  source: {{class: 'tired:Source'}}\n  one: {{class: 'tired:{name}', {more}}}\n"


@pytest.fixture
def robot(robot: Robot) -> Robot:
    (robot.folder / "tired.py").write_text(MODULES)
    return robot


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "more", "begin", "end"),
    [
        (
            "Slow",
            QUEUE,
            "messages dropped because it was too slow (sensor_msgs/Image)",
            "messages dropped",
        ),
        (
            "Hoarder",
            "",
            "copied into its own memory because it keeps 256 messages of others (",
            "messages copied",
        ),
        ("Late", "", "ticks missed", "ticks missed"),
        ("Tired", "", "100% tired", "(it was: 100% tired)"),
    ],
)
def test_trouble_is_one_line_when_it_begins_and_one_when_it_ends(
    robot: Robot, module: str, more: str, begin: str, end: str
) -> None:
    robot.write_profile(profile(module, more))
    robot.start()
    assert begin in degraded(robot, "one")["one"]["health"]
    assert "DEGRADED" in robot.command("top", "--once", "--interval", "0").stdout
    assert " health " in robot.command("list", "modules").stdout
    (robot.output / "quiet").touch()
    robot.until(lambda top: not top["one"]["health"])
    wait_until(lambda: "OK again" in robot.log("one"))
    lines = [line for line in robot.log("one").splitlines() if "DEGRADED" in line or "OK again" in line]
    assert len(lines) == 2, lines
    assert begin in lines[0]
    assert end in lines[1]


@pytest.mark.slow
def test_laser_that_was_never_plugged_in_is_told_everywhere(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was RUNNING and green, with nothing in the log, and the exit code was 0."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as service:
        service.bind(str(tmp_path / "notify"))
        service.settimeout(60)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        robot.write_profile(LASER)
        process = robot.start()
        degraded(robot, "laser")
        begun_s = time.monotonic()
        told = ""
        while "laser is DEGRADED: the device is disconnected: " not in told:
            told = service.recv(4096).decode()
        wait_until(lambda: time.monotonic() - begun_s > LASTING_S + 3 * LOOK_S)
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert ended.exit_code == 3, ended.stderr
    assert ended.summary["degraded"]["laser"].startswith("the device is disconnected: cannot open the port")
    assert robot.log("laser").count("DEGRADED: the device is disconnected: ") == 1
    doctor = robot.command("doctor", "robot")
    assert "/dev/no-such-laser is not there" in doctor.stdout
    assert doctor.returncode == 1


@pytest.mark.slow
@pytest.mark.every_turn
def test_run_in_which_a_module_never_came_up_fails(robot: Robot) -> None:
    robot.write_profile(
        """
modules:
  idle: {class: "zoo.modules:Idle"}
  broken: {class: "zoo.modules:CrashInSetup", restart: {max_restarts: 100}}
"""
    )
    process = robot.start()
    robot.until(lambda top: top["broken"]["restarts"] >= 2 and top["idle"]["state"] == "RUNNING")
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert ended.exit_code == 1
    assert ended.summary["reason"] == "SIGINT; broken never came up"
    assert "broken never came up: " in robot.log("supervisor")


@pytest.mark.slow
@pytest.mark.every_turn
def test_run_that_ends_while_a_module_starts_for_the_first_time_has_not_failed(robot: Robot) -> None:
    (robot.folder / "zoo" / "late.py").write_text(
        "import time\n\nfrom robbie_mp import Module\n\n\n"
        "class Late(Module):\n    def setup(self) -> None:\n        time.sleep(1.5)\n"  # within its grace
    )
    robot.write_profile("""
modules:
  idle: {class: "zoo.modules:Idle"}
  late: {class: "zoo.late:Late"}
""")
    process = robot.start()
    robot.until(lambda top: top["idle"]["state"] == "RUNNING" and top["late"]["state"] == "STARTING")
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert (ended.exit_code, ended.summary["reason"]) == (0, "SIGINT")
