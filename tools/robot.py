"""A robot under test, with its own workspace and runs folder; its supervisor is the campaign's child."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil
import yaml

from robbie_mp.attached.views.run_figures import state_name
from robbie_mp.base.linux.pidfd import open_process, send_signal
from robbie_mp.bus.observe import ModuleFigures, RunObserver
from robbie_mp.bus.transport.board import TOOL_PREFIX
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.supervisor.states import ChildState

REPOSITORY = Path(__file__).parents[1]
COMMAND = [sys.executable, "-c", "import sys; from robbie_mp.cli import main; sys.exit(main())"]
LIMIT_S = 60.0
POLL_S = 0.02
OFTEN = {"policy": "always", "max_restarts": 1_000_000, "backoff_s": 0.05, "backoff_cap_s": 0.1}
"""The restart policy of modules that are killed far more often than modules fail."""
SPARE = "spare"
"""Process name of a spare interpreter that has finished its imports."""


class RobotTrouble(RuntimeError):
    """The robot failed to do something that it must do in spite of all kills."""


class Robot:
    """A run of a profile.

    Args:
        folder: an empty or new folder for everything the robot writes.
        workspace: folder of the workspace with the profile.
        arguments: arguments of the command, the profile first.
        command: the command that starts the robot.
        on_host: the beginning of a command that runs it on another host of a test network.
    """

    def __init__(
        self,
        folder: Path,
        workspace: Path,
        *arguments: str,
        command: Sequence[str] = ("run",),
        on_host: Sequence[str] = (),
    ):
        self.output = folder / "output"
        runtime = folder / "runtime"
        runtime.mkdir(parents=True, mode=0o700)
        self.environment = environment() | {"XDG_RUNTIME_DIR": str(runtime)}
        self._stdout = (folder / "stdout").open("w+")
        self._stderr = (folder / "stderr").open("w+")
        self.supervisor = subprocess.Popen(
            [*on_host, *COMMAND, *command, *arguments, "--json", "--output", str(self.output)],
            cwd=workspace,
            env=self.environment,
            stdout=self._stdout,
            stderr=self._stderr,
        )
        self.bases = [runtime / "robbie"]
        self.run_id = ""
        self.observer: RunObserver | None = None

    def wait_until_running(self, limit_s: float = LIMIT_S) -> None:
        """Wait until all modules and the core are RUNNING."""
        self.wait_for(self.attach, "no run appeared")
        self.wait_for(self.all_running, "not every process is RUNNING", limit_s=limit_s)

    def attach(self) -> bool:
        """Find the run and its figures. Return whether they exist yet."""
        runs = list_runs(self.bases)
        if not runs:
            return False
        with contextlib.suppress(LookupError, OSError, ValueError):  # the run is just being made
            self.observer = RunObserver(runs[0].run_id)
            self.run_id = runs[0].run_id
        return self.observer is not None

    def figures(self) -> dict[str, ModuleFigures]:
        """Figures of modules and core by name, without attached tools."""
        if self.observer is None:
            raise RobotTrouble("the run does not exist yet")
        processes = self.observer.modules()[1:]
        return {one.name: one for one in processes if not one.name.startswith(TOOL_PREFIX)}

    @property
    def is_up(self) -> bool:
        """Whether the supervisor runs."""
        return self.supervisor.poll() is None

    def all_running(self) -> bool:
        """Whether every module and the core is RUNNING."""
        return all(_is_running(module) for module in self.figures().values())

    def wait_for(self, condition: Callable[[], bool], otherwise: str, limit_s: float = LIMIT_S) -> float:
        """Wait for a condition; return how long it took (s).

        Raises:
            RobotTrouble: the condition is not met in time, or the run has ended.
        """
        began_s = time.monotonic()
        while not condition():
            if not self.is_up:
                raise RobotTrouble(f"the run has ended, {self.supervisor.returncode}: {self._last_words()}")
            if time.monotonic() - began_s > limit_s:
                raise RobotTrouble(f"{otherwise}, after {limit_s} s")
            time.sleep(POLL_S)
        return time.monotonic() - began_s

    def wait_for_spare(self, limit_s: float = LIMIT_S) -> None:
        """Wait until a spare interpreter has finished its imports."""
        supervisor = psutil.Process(self.supervisor.pid)

        def is_warm() -> bool:
            return any(_name(child) == SPARE for child in supervisor.children())

        self.wait_for(is_warm, "no spare interpreter is warm", limit_s)

    def send(self, pid: int, number: signal.Signals) -> bool:
        """Send a signal to a child of this supervisor and to no other process; False if it has ended."""
        try:
            descriptor = open_process(pid)
        except ProcessLookupError:
            return False
        try:
            if psutil.Process(pid).ppid() != self.supervisor.pid:
                return False
            if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
                return False
            send_signal(descriptor, number)
        except (ProcessLookupError, psutil.NoSuchProcess):
            return False
        finally:
            os.close(descriptor)
        return True

    def stop(self) -> dict[str, Any]:
        """Stop the run normally, and return its summary."""
        self.supervisor.send_signal(signal.SIGINT)
        return self.wait_for_end()

    def wait_for_end(self, limit_s: float = LIMIT_S) -> dict[str, Any]:
        """Wait for the end of the run, and return its summary."""
        self.supervisor.wait(limit_s)
        summary = self.output / "summary.json"
        if not summary.exists():
            raise RobotTrouble(f"the run left no summary: {self._last_words()}")
        found: dict[str, Any] = json.loads(summary.read_text())
        return found

    def said(self) -> str:
        """Return the supervisor's output so far, which has each restart with its reason."""
        return Path(self._stderr.name).read_text(errors="replace")

    def _last_words(self) -> str:
        return self.said()[-2000:]

    def close(self) -> None:
        """End everything that still runs."""
        if self.is_up:
            self.supervisor.kill()  # its children die with it
            self.supervisor.wait()
        if self.observer is not None:
            self.observer.close()
        self._stdout.close()
        self._stderr.close()


def _is_running(module: ModuleFigures) -> bool:
    return state_name(module) == ChildState.RUNNING and module.pid != 0


def _name(process: psutil.Process) -> str:
    with contextlib.suppress(psutil.Error):
        return process.name()
    return ""


def environment() -> dict[str, str]:
    """Return an environment in which processes in other folders can import this repository.

    They do not see whether a test starts them: NiceGUI would then not compress what a page loads.
    """
    path = os.pathsep.join([str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])])
    own = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    return own | {"PYTHONPATH": path}


def free_port() -> int:
    """Return a port of this machine that no process listens on."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return int(listening.getsockname()[1])


def write_profile(workspace: Path, profile: Mapping[str, Any], name: str = "robot") -> None:
    """Write a profile into a workspace."""
    (workspace / "profiles").mkdir(parents=True, exist_ok=True)
    (workspace / "profiles" / f"{name}.yaml").write_text(yaml.safe_dump(dict(profile), sort_keys=False))


@contextlib.contextmanager
def running(
    folder: Path, profile: Mapping[str, Any], name: str = "robot", on_host: Sequence[str] = ()
) -> Iterator[Robot]:
    """Run a profile until the end of the block, and stop it then if it still runs.

    Args:
        folder: its workspace; what the robot writes goes into a new folder there.
        profile: the profile, as in its file.
        name: of the profile.
        on_host: the beginning of a command that runs it on another host of a test network.
    """
    write_profile(folder, profile, name)
    with stopping(Robot(folder / name, folder, name, on_host=on_host)) as robot:
        yield robot


@contextlib.contextmanager
def stopping(robot: Robot) -> Iterator[Robot]:
    """Stop a robot at the end of the block, if it still runs."""
    try:
        yield robot
    finally:
        with contextlib.suppress(RobotTrouble, subprocess.TimeoutExpired):
            if robot.is_up:
                robot.stop()
        robot.close()
