"""Runs small robots as a user does: a workspace, a profile, and the command line in a separate process."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from textwrap import dedent
from typing import Any

import psutil
import pytest

from robbie_mp.attached.views.run_figures import as_data
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.cli.runs import live_runs
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.run.trace.reader import entries

PROJECT = Path(__file__).parents[2]
ZOO = Path(__file__).parent / "zoo_modules.py"
OWN_RUNS = Path(__file__).parent / "own_runs.py"
COMMAND = [
    sys.executable,
    "-c",
    # Not by an import: a workspace has a folder `tests` of its own.
    f"import sys; exec(open({str(OWN_RUNS)!r}).read()); see_own_runs_only(); "
    "from robbie_mp.cli import main; sys.exit(main())",
]
"""The command line. It does not see other runs of the same user on this machine."""
LIMIT_S = 100.0


class Robot:
    """A workspace in a temporary folder and the runs started in it."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.output = folder / "out"
        (folder / "profiles").mkdir()
        (folder / "zoo").mkdir()
        (folder / "zoo" / "__init__.py").write_text("")
        (folder / "zoo" / "modules.py").write_text(ZOO.read_text())
        self._started: list[subprocess.Popen[str]] = []

    def write_profile(self, text: str, name: str = "robot", *, has_black_box: bool = False) -> None:
        """Write a profile; without a black box a robot starts sooner."""
        if not has_black_box:
            text = f"{dedent(text)}\nblack_box: false\n"
        (self.folder / "profiles" / f"{name}.yaml").write_text(text)

    def write_secret(self, name: str, text: str) -> None:
        """Write a file that only the user can read."""
        path = self.folder / name
        path.touch(mode=0o600)
        path.write_text(f"{text}\n")

    def command(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a command until it ends."""
        return subprocess.run(
            [*COMMAND, *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )

    def start(
        self,
        *arguments: str,
        profile: str = "robot",
        output: Path | None = None,
        command: Sequence[str] = ("run",),
    ) -> subprocess.Popen[str]:
        """Start a run and return at once."""
        options = ["--json", "--output", str(output or self.output)]
        process = subprocess.Popen(
            [*COMMAND, *command, profile, *options, *arguments],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._started.append(process)
        return process

    def run(self, *arguments: str, profile: str = "robot") -> "Ended":
        """Run until the run ends."""
        return Ended.wait_for(self.start(*arguments, profile=profile))

    def known_run(self) -> KnownRun:
        """The only run."""
        (run,) = live_runs()
        return run

    def top(self) -> dict[str, dict[str, Any]]:
        """Figures of the modules of the only run, by name; empty while there is none."""
        runs = live_runs()
        if len(runs) != 1:
            return {}
        try:
            with closing(RunObserver(runs[0].run_id)) as observer:
                return {module.name: as_data(module) for module in observer.modules()}
        except SegmentMissing:
            return {}

    def until(self, condition: Callable[[dict[str, dict[str, Any]]], bool]) -> dict[str, dict[str, Any]]:
        """Wait until the run's figures fulfil a condition; return them."""
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            figures = self.top()
            if figures and condition(figures):
                return figures
            if not figures and self._started and all(run.poll() is not None for run in self._started):
                raise AssertionError(f"the run has ended: {self._started[-1].communicate()}")
            time.sleep(0.005)
        raise TimeoutError(f"the condition was not met; last figures: {figures}")

    def journal(self, name: str) -> list[int]:
        """The journal of a module of the zoo."""
        file = self.output / f"{name}.journal"
        return [int(line) for line in file.read_text().split()] if file.exists() else []

    def log(self, name: str) -> str:
        """The whole output of a process."""
        return "\n".join(line for entry in entries(self.output, [name]) for line in entry.lines())

    def close(self) -> None:
        """End all processes that still run."""
        for process in self._started:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(15)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait(5)
            for stream in (process.stdout, process.stderr):
                if stream is not None:
                    stream.close()


@contextmanager
def robot_in(folder: Path) -> Iterator[Robot]:
    """An empty workspace with the zoo's modules; no other runs are listed."""
    runtime, workspace = folder / "runtime", folder / "workspace"
    runtime.mkdir(mode=0o700)
    workspace.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(runtime))
        patch.setenv("PYTHONPATH", str(PROJECT))
        with closing(Robot(workspace)) as robot:
            yield robot


class Ended:
    """How a run ended."""

    def __init__(self, exit_code: int, stdout: str, stderr: str):
        self.exit_code = exit_code
        self.stderr = stderr
        self.summary = json.loads(stdout) if stdout.startswith("{") else {}
        self.modules = {module["name"]: module for module in self.summary.get("modules", ())}

    @classmethod
    def wait_for(cls, process: "subprocess.Popen[str]") -> "Ended":
        stdout, stderr = process.communicate(timeout=LIMIT_S)
        return cls(process.returncode, stdout, stderr)

    @classmethod
    def in_order(cls, process: "subprocess.Popen[str]", sent: int = signal.SIGINT) -> "Ended":
        """Stop a run by a signal; it must end with success."""
        process.send_signal(sent)
        ended = cls.wait_for(process)
        assert ended.exit_code == 0, ended.stderr
        return ended


def is_running(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def command_of(process: psutil.Process) -> list[str]:
    """The words of a process's command; empty if it has ended, even while this reads it."""
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


def wait_until(condition: Callable[[], bool], limit_s: float = LIMIT_S) -> float:
    """Wait for a condition; return how long it took."""
    started = time.monotonic()
    while not condition():
        if time.monotonic() - started > limit_s:
            raise TimeoutError(f"not within {limit_s} s")
        time.sleep(0.005)
    return time.monotonic() - started


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
