"""A class of messages that is edited while the robot runs is refused, and nobody reads shifted fields."""

import json
import os
import subprocess
import sys
from contextlib import closing

import pytest

from robbie_mp.logs.capture.recorded_run import RecordedRun
from tests._support.robot import PROJECT, Robot, kill, wait_until

PAIR = """
from robbie_mp import Message, float64


class Pair(Message, name="team_msgs/msg/Pair", version=1):
    left: float64
    right: float64
"""
SWAPPED = PAIR.replace("    left: float64\n", "") + "    left: float64\n"
SPEAKER = """
from robbie_mp import Module
from pair import Pair


class PairSource(Module):
    period_s = 0.01

    def tick(self):
        self.publish(Pair(left=1.0, right=-1.0), topic="pair")
"""
LISTENER = """
from robbie_mp import Module
from pair import Pair


class PairSink(Module):
    def setup(self):
        self.right = self.wrong = 0
        self.subscribe(Pair, self.on_pair)

    def on_pair(self, pair):
        is_right = (pair.left, pair.right) == (1.0, -1.0)
        self.right += is_right
        self.wrong += not is_right
        self.status = f"version {pair.version}: {self.right} right, {self.wrong} wrong"
"""
PROFILE = """
modules:
  speaker: {class: "speaker:PairSource", restart: {max_restarts: 1, retry_s: 0}}
  listener: {class: "listener:PairSink"}
"""
SCRIPT = """
import robbie_mp
from pair import Pair

with robbie_mp.attach() as run:
    for use in (lambda: run.latest(Pair), lambda: run.publish(Pair(left=1.0, right=-1.0), topic="pair")):
        try:
            print(use())
        except robbie_mp.RobbieError as error:
            print(type(error).__name__, error)
"""


@pytest.fixture
def speaking(robot: Robot) -> Robot:
    """A robot with a module that publishes pairs, and one that looks at them; not started yet."""
    for name, code in {"pair": PAIR, "speaker": SPEAKER, "listener": LISTENER}.items():
        (robot.folder / f"{name}.py").write_text(code)
    robot.write_profile(PROFILE)
    return robot


def heard(robot: Robot) -> dict[str, int]:
    """Return how many pairs the listener has read rightly and wrongly, and of which version."""
    words = robot.top()["listener"]["status"].replace(":", "").replace(",", "").split()
    return {"version": int(words[1]), "right": int(words[2]), "wrong": int(words[4])} if words else {}


def wait_for_line(robot: Robot, name: str, text: str) -> None:
    wait_until(lambda: text in robot.log(name))


@pytest.mark.slow
def test_restarted_publisher_of_an_edited_class_crashes_and_nobody_reads_shifted_fields(
    speaking: Robot,
) -> None:
    speaking.start()
    speaking.until(lambda top: top["listener"]["handled"] > 5)
    (speaking.folder / "pair.py").write_text(SWAPPED)
    kill(speaking.top()["speaker"]["pid"])
    speaking.until(lambda top: top["speaker"]["state"] == "FAILED" or heard(speaking)["wrong"] > 0)
    assert heard(speaking)["wrong"] == 0
    said = speaking.log("speaker")
    assert "ChangedType" in said
    assert "pair.py:5: team_msgs/msg/Pair, version 1, has other fields than in this run: " in said
    assert "field 1 was `float64 left` and is `float64 right`" in said

    (speaking.folder / "script.py").write_text(SCRIPT)
    script = subprocess.run(
        [sys.executable, "script.py"],
        cwd=speaking.folder,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert script.stdout.count("ChangedType") == 2, script


@pytest.mark.slow
def test_reload_keeps_what_runs_until_the_version_is_raised(speaking: Robot) -> None:
    speaking.start("--reload")
    speaking.until(lambda top: top["listener"]["handled"] > 5)
    before = {name: speaking.top()[name]["pid"] for name in ("speaker", "listener")}
    (speaking.folder / "pair.py").write_text(SWAPPED)
    for name in before:
        wait_for_line(speaking, name, "pair.py was saved, but the one that runs stays")
        assert "pair.py:5: team_msgs/msg/Pair, version 1, has other fields" in speaking.log(name)
    assert {name: speaking.top()[name]["pid"] for name in before} == before
    assert heard(speaking)["wrong"] == 0

    with closing(RecordedRun(speaking.known_run().folder)) as recorded:
        assert recorded.schema("team_msgs/msg/Pair", 2) is None
        (speaking.folder / "pair.py").write_text(SWAPPED.replace("version=1", "version=2"))
        speaking.until(lambda _: heard(speaking).get("version") == 2)
        schemas = [recorded.schema("team_msgs/msg/Pair", version) for version in (2, 1)]
    assert schemas == ["float64 right\nfloat64 left\n", "float64 left\nfloat64 right\n"]
    assert heard(speaking)["wrong"] == 0
    echo = speaking.command("echo", "pair", "--once", "--json")
    assert json.loads(echo.stdout)["message"] == {"right": -1.0, "left": 1.0}, echo
