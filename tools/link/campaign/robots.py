"""The two robots of a campaign: robot `red` sends, robot `blue` receives; a router may be between them."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.messages import LinkState
from robbie_mp.run.live_runs import live_runs
from robbie_mp.run.run_directory import KnownRun

PROJECT = Path(__file__).parents[3]
PROFILE = """
modules:
  {role}: {{class: "tools.link.campaign.modules:{cls}"}}
  books: {{class: "tools.link.campaign.modules:Books"}}
  link:
    class: robbie_mp.connect.link.module:Link
    settings:
      robot: {name}
      mode: {mode}
      listen: {listen}
      connect: {connect}
      robots: {robots}
      state_hz: 1000
      command_expires_s: 2.0
      send: {send}
      accept: {{"*": ["*"]}}
    restart: {{policy: always, max_restarts: 100000, within_s: 60, backoff_s: 0.02, backoff_cap_s: 0.1}}
"""
SEND = """{
        urgent: ["String urgent"], command: ["String command"], state: ["String state"],
        reliable: ["String reliable"], bulk: [Image]}"""
COMMAND = "import sys; from robbie_mp.cli import main; sys.exit(main())"
PATIENCE_S = 120.0
ROUTER = "router"


class Robots:
    """Two runs on this machine, linked over loopback.

    Args:
        folder: an empty folder for both.
        has_router: whether they are linked through a router of Zenoh.
    """

    def __init__(self, folder: Path, *, has_router: bool = False):
        self.folder = folder
        self.has_router = has_router
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        (folder / "profiles").mkdir()
        with socket.socket() as listening:
            listening.bind(("127.0.0.1", 0))
            self._address = f"tcp/127.0.0.1:{listening.getsockname()[1]}"
        address = f"[{self._address}]"
        listen, connect = ("[]", address) if has_router else (address, "[]")
        self._write("red", "talker", "Talker", listen, connect, SEND)
        self._write("blue", "listener", "Listener", "[]", address, "{}")

    def start_router(self) -> None:
        """Start the router."""
        command = [sys.executable, "-m", "tools.link.campaign.router", self._address]
        with open(self.folder / "router.log", "ab") as log:
            self.processes[ROUTER] = subprocess.Popen(command, cwd=PROJECT, stdout=log, stderr=log)

    def _write(self, name: str, role: str, cls: str, listen: str, connect: str, send: str) -> None:
        robots = "[blue]" if name == "red" else "[]"
        (self.folder / "profiles" / f"{name}.yaml").write_text(
            PROFILE.format(
                mode="client" if self.has_router else "peer",
                name=name,
                role=role,
                cls=cls,
                listen=listen,
                connect=connect,
                send=send,
                robots=robots,
            )
        )

    def start(self, name: str) -> None:
        """Start a robot."""
        command = [sys.executable, "-c", COMMAND, "run", name, "--quiet"]
        with open(self.folder / f"{name}.log", "ab") as log:
            self.processes[name] = subprocess.Popen(
                [*command, "--output", str(self.output(name))],
                cwd=self.folder,
                stdout=log,
                stderr=log,
                env=os.environ | {"PYTHONPATH": str(PROJECT)},
            )

    def stop(self) -> None:
        """Stop both robots in good order, then the router."""
        if ROUTER in self.processes:
            router = self.processes.pop(ROUTER)
            self._stop_robots()
            router.kill()
            router.wait()
        else:
            self._stop_robots()

    def _stop_robots(self) -> None:
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def kill(self, name: str) -> None:
        """Kill the router, or a robot's supervisor; the kernel then kills all processes of that robot."""
        self.processes[name].kill()
        self.processes[name].wait()

    def kill_link(self, name: str) -> bool:
        """Kill the process of a robot's link; False if there is none now."""
        pid = self.pid(name, "link")
        if pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return bool(pid)

    def output(self, name: str) -> Path:
        """Return the output folder of a robot."""
        return self.folder / f"out-{name}"

    def run(self, name: str) -> KnownRun | None:
        """Return the live run of a robot."""
        pid = self.processes[name].pid
        return next((run for run in live_runs() if run.record and run.record.supervisor_pid == pid), None)

    def pid(self, name: str, module: str) -> int:
        """Return the process of a module; 0 if there is none now."""
        run = self.run(name)
        if run is None:
            return 0
        try:
            with closing(RunObserver(run.run_id)) as observer:
                return next((one.pid for one in observer.modules() if one.name == module), 0)
        except SegmentMissing:
            return 0

    def core_counts(self, name: str) -> dict[str, int]:
        """Return how many messages a robot's link did not get from its core, by topic, as the core counts."""
        run = self.run(name)
        assert run is not None
        with closing(RunObserver(run.run_id)) as observer:
            (link,) = (one for one in observer.modules() if one.name == "link")
            return {
                "bulk" if one.topic == "*" else one.topic: one.dropped + one.lost
                for one in link.subscriptions
            }

    def numbers(self, name: str, journal: str) -> list[int]:
        """Return a journal of a robot."""
        path = self.output(name) / journal
        return [int(line) for line in path.read_text().split()] if path.exists() else []

    def state(self, name: str) -> LinkState | None:
        """Return the last state of a robot's link."""
        path = self.output(name) / "link.state"
        return LinkState.decode(path.read_bytes()) if path.exists() else None

    def forget_state(self, name: str) -> None:
        """Forget the last state of a robot's link, because that robot is gone."""
        (self.output(name) / "link.state").unlink(missing_ok=True)


def wait_until(condition: Callable[[], bool], what: str, *, pause_s: float = 0.02) -> None:
    """Wait for a condition, and look at it each `pause_s`.

    Raises:
        TimeoutError: it did not come true.
    """
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError(f"not within {PATIENCE_S} s: {what}")
        time.sleep(pause_s)
