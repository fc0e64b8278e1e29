"""Follows docs/tutorial.md and docs/camera-robot.md word for word, and compares the shown output.

Numbers may differ.
"""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from robbie_mp.bus.observe import ModuleFigures, RunObserver
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.cli.runs import live_runs
from robbie_mp.module.setting_changes import TRIAL_S
from tests._support.robot import wait_until
from tests.docs._support.pages import ROOT, Block, blocks

pytestmark = pytest.mark.slow

PROGRAMS = {
    "robbie": '-c "import sys; from robbie_mp.cli import main; sys.exit(main())"',
    "python3": "",
}
LIMIT_S = 30.0


def shape(text: str) -> str:
    """A text with all numbers, and all runs of blanks, made equal."""
    return " ".join(re.sub(r"\d+(\.\d+)?", "0", text).split())


class Reader:
    """A reader with two terminals who follows the tutorial."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.answer = ""
        self.run_output = folder / "run.txt"
        self.process: subprocess.Popen[bytes] | None = None
        self.actions: dict[str, Callable[[str], None]] = {
            "run": self.type,
            "start": self.start,
            "output": self.see,
            "output of the run": self.see_in_first_terminal,
            "fails with 2": lambda text: self.type(text, exit_code=2),
            "run when the sensor has spoken": self.type_when("sensor", lambda sensor: sensor.published > 0),
            "run when the watch has counted to 10": self.type_when(
                "watch", lambda watch: watch.handled >= 10
            ),
            "run when the change has stayed": self.type_later,
            "run when the watch was restarted": self.type_when(
                "watch", lambda watch: watch.restarts == 1 and watch.status != ""
            ),
            "run when the controller follows the ball": self.type_until_it_follows,
            "stop the run": lambda _text: self.stop(),
        }

    def do(self, step: Block) -> None:
        action = step.mark.removeprefix("test: ")
        if action.startswith("append to "):
            with (self.folder / action.removeprefix("append to ")).open("a") as file:
                file.write(step.text)
        elif action.startswith("file "):
            (self.folder / action.removeprefix("file ")).write_text(step.text)
        elif match := re.fullmatch(r"replace (\w+) in (.*)", action):
            changed = self.folder / match[2]
            changed.write_text(changed.read_text().partition(f"class {match[1]}(")[0] + step.text)
        elif action.startswith("change "):
            self.change(self.folder / action.removeprefix("change "), step.text)
        else:
            self.actions[action](step.text)

    def change(self, file: Path, difference: str) -> None:
        """Replace each line that begins with a minus by the next, which begins with a plus."""
        lines = difference.splitlines()
        for old, new in zip(lines[::2], lines[1::2], strict=True):
            text = file.read_text()
            assert (old[0], new[0], text.count(old[1:])) == ("-", "+", 1)
            file.write_text(text.replace(old[1:], new[1:]))

    def type(self, text: str, exit_code: int = 0) -> None:
        """Type into the second terminal, which stays in the folder it is in."""
        folder_file = self.folder.parent / "folder"
        done = subprocess.run(
            ["sh", "-e"],
            input=f"{text}\npwd > {shlex.quote(str(folder_file.absolute()))}\n",
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        self.answer = done.stdout
        assert done.returncode == exit_code, f"{text}\n{done.stdout}"
        if exit_code == 0:
            self.folder = Path(folder_file.read_text().strip())

    def type_when(self, name: str, condition: Callable[[ModuleFigures], bool]) -> Callable[[str], None]:
        def action(text: str) -> None:
            wait_until(lambda: (module := self.module(name)) is not None and condition(module), LIMIT_S)
            self.type(text)

        return action

    def type_until_it_follows(self, text: str) -> None:
        """A busy machine may lose the ball between two looks."""

        def follows() -> bool:
            controller = self.module("controller")
            if controller is None or controller.states != "FOLLOW" or controller.handled < 5:
                return False
            self.type(text)
            return "[FOLLOW]" in self.answer

        wait_until(follows, LIMIT_S)

    def type_later(self, text: str) -> None:
        since_s = time.monotonic()
        wait_until(lambda: time.monotonic() > since_s + TRIAL_S + 1.0)
        self.type(text)

    def start(self, text: str) -> None:
        """Start a command in the first terminal."""
        with self.run_output.open("wb") as output:
            self.process = subprocess.Popen(
                shlex.split(text), cwd=self.folder, stdout=output, stderr=subprocess.STDOUT
            )

    def module(self, name: str) -> ModuleFigures | None:
        """Figures of a module, as soon as there is a run with it."""
        try:
            observer = RunObserver(self.run_id())
        except (IndexError, SegmentMissing, SegmentMismatch):  # not made yet, or only half of it
            return None
        with closing(observer):
            return next((module for module in observer.modules() if module.name == name), None)

    def run_id(self) -> str:
        """The one run of this reader; others may run on this machine."""
        mine = [run for run in live_runs() if run.folder.is_relative_to(os.environ["XDG_RUNTIME_DIR"])]
        return mine[0].run_id

    def see(self, text: str) -> None:
        for line in text.splitlines():
            assert shape(line) in shape(self.answer), self.answer

    def see_in_first_terminal(self, text: str) -> None:
        def is_seen(line: str) -> bool:
            return shape(line) in shape(self.run_output.read_text())

        for line in text.splitlines():
            wait_until(partial(is_seen, line), LIMIT_S)

    def stop(self) -> None:
        """Press Ctrl-C in the first terminal."""
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(LIMIT_S) == 0
        output = max((self.folder / "output").glob("*/*"), key=lambda folder: folder.stat().st_mtime)
        summary = json.loads((output / "summary.json").read_text())
        modules = {module["name"] for module in summary["modules"]} - {"supervisor"}
        assert "core" in modules and len(modules) > 1
        assert all((output / "log" / f"{name}.jsonl").exists() for name in modules)


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Reader]:
    """A reader who has just installed Robbie-MP."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, arguments in PROGRAMS.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {arguments} "$@"\n')
        program.chmod(0o755)
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    home = tmp_path / "home"
    home.mkdir()
    made = Reader(home)
    yield made
    if made.process is not None and made.process.poll() is None:
        made.process.send_signal(signal.SIGTERM)
        made.process.wait(LIMIT_S)


def test_whole_tutorial_works_as_written(reader: Reader) -> None:
    steps = [step for step in blocks("docs/tutorial.md") if step.mark.startswith("test: ")]
    assert len(steps) > 15
    for step in steps:
        reader.do(step)


def test_robot_with_a_camera_works_as_written(reader: Reader) -> None:
    steps = [step for step in blocks("docs/camera-robot.md") if step.mark.startswith("test: ")]
    assert len(steps) > 15
    for step in steps:
        reader.do(step)
    logs = [*(reader.folder / "output").glob("*/*/log/camera.jsonl")]
    assert logs
    assert not any("was copied" in log.read_text() for log in logs)


def test_different_output_is_detected(reader: Reader) -> None:
    reader.type("echo watch RUNNING 3")
    reader.see("watch   RUNNING  4")
    with pytest.raises(AssertionError):
        reader.see("watch   FAILED  3")
