"""`robbie shadow` compares other code beside a module, and keeps it from what belongs to the robot."""

import json
import os
import signal
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests._support.robot import COMMAND, LIMIT_S, Robot, wait_until

MODULES = """
from robbie_mp import Message, Module, int64, setting


class Number(Message, name="shadow/msg/Number", version=1):
    value: int64


class Double(Message, name="shadow/msg/Double", version=1):
    value: int64


class Source(Module):
    period_s = 0.01
    count = 0

    def tick(self):
        self.count += 1
        self.publish(Number(value=self.count))


class Doubler(Module):
    factor: int = setting(2, "what each number is multiplied by")

    def setup(self):
        self.subscribe(Number, self.on_number)

    def on_number(self, number):
        self.publish(Double(value=self.factor * number.value))


class Wheels(Module):
    def setup(self):
        self.subscribe(Double, self.on_double)
        self.count = 0

    def on_double(self, double):
        self.count += 1
        assert double.value % 2 == 0, "a shadow has moved the robot"
        self.status = f"{self.count}"
"""
PROFILE = """
modules:
  source: {class: "numbers_shadow:Source"}
  doubler: {class: "numbers_shadow:Doubler"}
  wheels: {class: "numbers_shadow:Wheels"}
"""


@pytest.fixture
def doubling(robot: Robot) -> Robot:
    """A robot with a module that doubles numbers, and one that fails over any number that is odd."""
    (robot.folder / "numbers_shadow.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda top: top["wheels"]["status"] not in ("", "0"))
    return robot


def variant(robot: Robot, change: str) -> str:
    """A file in which the doubler does this with each number."""
    path = robot.folder / "changed.py"
    handler = "self.publish(Double(value=self.factor * number.value))"
    path.write_text(MODULES.replace(handler, change))
    return str(path)


def shadow(robot: Robot, *words: str) -> tuple[int, dict[str, Any]]:
    done = robot.command("shadow", "doubler", "--for", "2s", "--json", *words)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.mark.slow
def test_same_code_publishes_the_same_and_nobody_notices(doubling: Robot) -> None:
    code, report = shadow(doubling)
    assert (code, report["equal"], report["lost"], report["end"]) == (0, True, 0, "")
    assert report["channels"][0]["equal"] > 0
    top = doubling.top()
    assert top["wheels"]["restarts"] == top["doubler"]["restarts"] == 0
    assert top["wheels"]["handled"] == pytest.approx(top["doubler"]["published"], abs=50)


@pytest.mark.slow
def test_other_settings_show_how_much_they_change(doubling: Robot) -> None:
    code, report = shadow(doubling, "--set", "factor=3")
    assert code == 1
    (channel,) = report["channels"]
    assert channel["different"] > 0
    assert channel["first_difference"]["field"] == "value"
    assert channel["amounts"]["value"]["largest"] >= 1
    assert doubling.top()["wheels"]["restarts"] == 0


ENDS = {
    "import os; os._exit(3)": "exit code 3",
    "import os, signal; signal.raise_signal(signal.SIGKILL)": "killed by SIGKILL",
    "raise ValueError('no number')": "ValueError: no number",
    "self.stop()": "stopped itself",
    "open('/dev/ttyS0')": "must not open /dev/ttyS0",
    "open('here', 'w')": "must not write",
    "import socket; socket.socket().connect(('127.0.0.1', 9))": "the network",
    "import subprocess; subprocess.run(['true'])": "other programs",
}


@pytest.mark.slow
def test_shadow_that_dies_or_reaches_for_the_robot_ends_and_says_why(doubling: Robot) -> None:
    for change, said in ENDS.items():
        code, report = shadow(doubling, "--with", variant(doubling, change))
        assert code == 1
        assert said in report["end"], report
    assert not (doubling.folder / "here").exists()
    top = doubling.top()
    assert {one["restarts"] for one in top.values()} == {0}


@pytest.mark.slow
def test_shadow_that_hangs_or_floods_is_ended_and_delays_nobody(doubling: Robot) -> None:
    code, report = shadow(doubling, "--with", variant(doubling, "import time; time.sleep(1000)"))
    assert code == 1 or report["unhandled"] > 0
    assert report["unhandled"] > 0
    flood = "[self.publish(Double(value=1)) for _ in range(10_000)]"
    code, report = shadow(doubling, "--with", variant(doubling, flood))
    assert code == 1
    assert report["channels"][0]["only_in_shadow"] > 0
    top = doubling.top()
    assert {one["restarts"] for one in top.values()} == {0}
    assert doubling.known_run()


@pytest.mark.slow
def test_killed_and_stopped_tools_leave_nothing_behind(doubling: Robot) -> None:
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        with subprocess.Popen(
            [*COMMAND, "shadow", "doubler", "--json"],
            cwd=doubling.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as tool:  # fmt: skip
            assert tool.stderr is not None
            assert "runs; Ctrl-C ends it" in tool.stderr.readline()
            children = _children(tool.pid)
            os.kill(children[0], signal.SIGSTOP)
            tool.send_signal(signum)
            stdout, stderr = tool.communicate(timeout=LIMIT_S)
        assert (tool.returncode == -signal.SIGKILL) == (signum == signal.SIGKILL), stderr
        assert bool(stdout) == (signum != signal.SIGKILL)
        if signum == signal.SIGKILL:
            os.kill(children[0], signal.SIGCONT)
        wait_until(partial(_are_gone, children))
    assert {one["restarts"] for one in doubling.top().values()} == {0}


def _are_gone(pids: list[int]) -> bool:
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


def _children(pid: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.slow
def test_mistakes_are_said_before_anything_runs(doubling: Robot) -> None:
    wrong = variant(doubling, "return return")
    done = doubling.command("shadow", "doubler", "--with", wrong)
    assert (done.returncode, done.stdout) == (2, "")
    assert "SyntaxError" in done.stderr
    done = doubling.command("shadow", "doubler", "--set", "factor=many")
    assert done.returncode == 2
    done = doubling.command("shadow", "dubler")
    assert "did you mean 'doubler'" in done.stderr


@pytest.mark.slow
def test_log_gives_the_same_messages(robot: Robot) -> None:
    (robot.folder / "numbers_shadow.py").write_text(MODULES)
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda top: top["wheels"]["status"] not in ("", "0"))
    recorded = robot.command("record", "-o", "recording", "--duration", "4s")
    assert recorded.returncode == 0, recorded.stderr
    robot.command("stop")

    done = robot.command("shadow", "doubler", "--log", "recording", "--json")
    assert done.returncode == 0, done.stderr + done.stdout
    report = json.loads(done.stdout)
    assert report["channels"][0]["equal"] > 10
    done = robot.command("shadow", "doubler", "--with", variant(robot, "pass"), "--log", "recording")
    assert done.returncode == 1
    assert "only module" in done.stdout
