"""Lets one kind of crash happen, replays it, and has its test written and run."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from robbie_mp.base.errors import RobbieError
from tests._support.robot import Robot
from tests.logs.strangers_kinds.kind import Kind

ENDS_S = 150.0
"""A robot that has not crashed by then does not."""
MESSAGE = re.compile(r"\bharness\.(?:send|send_encoded|reply|refuse|call|send_goal|feed_back|end_goal)\(")
TEST_S = 40.0
"""A written test that has not ended by then hangs."""
FEW_PLUGINS = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}


@dataclass(frozen=True)
class Outcome:
    """What became of a kind of crash.

    Attributes:
        kind: its name.
        crashed: whether the robot ended as the kind says.
        replayed: whether the replay says so, and names the line that the kind names.
        verdict: what the replay said.
        messages: how many messages the written test has; None: there is none.
        fails: whether the written test fails, as it should.
        test: the written test.
    """

    kind: str
    crashed: bool
    replayed: bool
    verdict: str
    messages: int | None = None
    fails: bool = False
    test: str = ""

    def row(self) -> str:
        """Return the outcome as a row of a table."""
        replayed = "replayed" if self.replayed else "NOT replayed" if self.crashed else "DID NOT CRASH"
        messages = "-" if self.messages is None else str(self.messages)
        fails = "fails" if self.fails else "passes" if self.test else "no test"
        return f"{self.kind:38} {replayed:13} {messages:>4} {fails:8} {self.verdict}"


def try_out(kind: Kind, folder: Path) -> Outcome:
    """Let it crash in a workspace in this empty folder, and replay it."""
    with closing(Robot(folder)) as robot:
        for name, text in kind.workspace().items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        said = run(robot, kind)
        capsules = sorted((folder / "out/log/crashes").glob("victim-*.capsule"))
        if len(capsules) != kind.crashes:
            return Outcome(kind.name, False, False, f"{len(capsules)} capsules; {said[-600:]}")
        return replay(robot, kind, capsules[-1])


def run(robot: Robot, kind: Kind) -> str:
    """Run the robot until its module is FAILED; return what it said."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in kind.environment.items():
            patch.setenv(name, value)
        process = robot.start()
        if kind.commands:
            robot.until(lambda modules: "victim" in modules and modules["victim"]["state"] == "RUNNING")
        for command in kind.commands:
            robot.command(*command)  # may fail: it gets no answer of a module that it killed
        return process.communicate(timeout=ENDS_S)[1]


def replay(robot: Robot, kind: Kind, capsule: Path) -> Outcome:
    """Replay its capsule, and run the test that is made of it."""
    said = json.loads(capsule.with_suffix(".json").read_text())
    crashed = kind.error in str(said["said"]) + said["reason"]
    place = kind.place()
    verdict = robot.command("replay", str(capsule), "--json")
    try:
        answer = json.loads(verdict.stdout)
    except ValueError:
        return Outcome(kind.name, crashed, False, f"no verdict: {verdict.stdout} {verdict.stderr[-600:]}")
    lines = " | ".join(answer["lines"])
    step = re.search(r"in step (\d+) of (\d+)", lines)
    is_last = step is None or step[1] == step[2]  # one that comes too soon is not the same
    error = kind.error.replace("hung", "a hang")
    replayed = answer["is_same"] and error in lines and place in lines and is_last
    written = robot.command("replay", str(capsule), "--as-test", "tests/test_crash.py")
    file = robot.folder / "tests/test_crash.py"
    if not file.exists():
        note = f"{lines} || {(written.stdout + written.stderr)[-300:]}"
        return Outcome(kind.name, crashed, replayed, note)
    test = file.read_text()
    left = re.search(r"(\d+) of \d+ messages", written.stdout)
    messages = int(left[1]) if left else len(MESSAGE.findall(test))
    all_fail = all(fails(robot.folder, kind, runner) for runner in ("pytest", "unittest"))
    return Outcome(kind.name, crashed, replayed, lines, messages, all_fail, test)


def fails(folder: Path, kind: Kind, runner: str) -> bool:
    """Whether the written test fails because of the same crash, with this runner of tests."""
    command = [sys.executable, "-m", runner, "tests/test_crash.py"]
    environment = {**os.environ, **FEW_PLUGINS}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return kind.error == "hung"
    words = [kind.error, kind.error.replace("exit code", "SystemExit:")]
    is_same = any(word in done.stdout + done.stderr for word in words) or done.returncode not in (0, 1)
    return done.returncode != 0 and is_same


def attempt(kind: Kind, folder: Path) -> Outcome:
    """Try a kind out; what goes wrong is an outcome, too."""
    folder.mkdir()
    try:
        return try_out(kind, folder)
    except (AssertionError, OSError, RobbieError, subprocess.TimeoutExpired) as error:
        return Outcome(kind.name, False, False, repr(error)[-600:])


def table(outcomes: Sequence[Outcome]) -> str:
    """Return all outcomes as a table."""
    rows = [outcome.row() for outcome in outcomes]
    return "\n".join([f"{'kind':38} {'replay':13} left {'test':8} verdict", *rows])
