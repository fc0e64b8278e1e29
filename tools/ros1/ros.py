"""A ROS system on this machine: its master, and nodes that know nothing of Robbie-MP."""

import contextlib
import json
import os
import select
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xmlrpc import client

import psutil

from tools.robot import free_port

SYSTEM_PYTHON = "/usr/bin/python3"
ROSCORE = "/usr/bin/roscore"
WITNESS = Path(__file__).parent / "witness.py"
LIMIT_S = 60.0


class RosTrouble(RuntimeError):
    """ROS does not do what it must do before the robot can be judged."""


class Ros:
    """The real roscore, which listens on this machine only.

    Args:
        folder: where ROS writes.
    """

    def __init__(self, folder: Path):
        self.port = free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.environment = {
            **os.environ,
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder / "ros"),
            "ROS_LOG_DIR": str(folder / "ros"),
        }
        self.environment.pop("ROS_HOSTNAME", None)
        (folder / "ros").mkdir(exist_ok=True)
        self._log = (folder / "ros" / "said").open("a")
        self._core: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Start roscore; return the time (monotonic, s) at which its master answered."""
        self._core = self._run([ROSCORE, "-p", str(self.port)])
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            if self.answers():
                return time.monotonic()
            time.sleep(0.02)
        raise RosTrouble(f"roscore does not answer: {Path(self._log.name).read_text()[-1000:]}")

    def answers(self) -> bool:
        """Whether the master is there."""
        try:
            return bool(self.call("getPid")[0] == 1)
        except (OSError, client.Error):
            return False

    def call(self, name: str, *arguments: Any) -> Any:
        """Call the master."""
        with client.ServerProxy(self.uri) as master:
            return getattr(master, name)("/trial", *arguments)

    def kill(self) -> None:
        """Kill roscore with the master and all that belongs to it, as kill -9 does."""
        if self._core is None:
            return
        root = psutil.Process(self._core.pid)
        for process in (root, *root.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        self._core.wait()
        self._core = None
        deadline = time.monotonic() + LIMIT_S
        while self.answers() and time.monotonic() < deadline:
            time.sleep(0.01)

    def close(self) -> None:
        """End ROS."""
        self.kill()
        self._log.close()

    def rostopic(self, *arguments: str) -> str:
        """Return what the command rostopic prints."""
        done = subprocess.run(
            ["/usr/bin/rostopic", *arguments],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        return done.stdout

    @contextlib.contextmanager
    def witness(self, name: str, topics: Mapping[str, str], *, drives: bool = False) -> Iterator["Witness"]:
        """A node that reads topics, given with their types."""
        command = [SYSTEM_PYTHON, str(WITNESS), name, json.dumps(topics), *(["--drive"] if drives else [])]
        process = self._run(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            yield Witness(process)
        finally:
            process.send_signal(signal.SIGKILL)
            process.communicate()

    def _run(self, command: list[str], **options: Any) -> "subprocess.Popen[bytes]":
        streams = {"stdin": subprocess.DEVNULL, "stdout": self._log, "stderr": self._log, **options}
        return subprocess.Popen(command, env=self.environment, **streams)


class Witness:
    """A node's count of messages read.

    Args:
        process: the node.
    """

    def __init__(self, process: "subprocess.Popen[bytes]"):
        self._process = process
        self._text = b""

    def stand_still(self) -> None:
        """Stop the node for ever, without ending it."""
        self._process.send_signal(signal.SIGSTOP)

    def read(self, count: int, limit_s: float) -> set[str]:
        """Wait until messages of `count` topics have come, at most for a limit; return the topics."""
        assert self._process.stdout is not None
        deadline = time.monotonic() + limit_s
        while self._text.count(b"\n") < count and (left_s := deadline - time.monotonic()) > 0:
            ready, _, _ = select.select([self._process.stdout], [], [], left_s)
            if ready:
                more = os.read(self._process.stdout.fileno(), 65536)
                if not more:
                    break
                self._text += more
        return set(self._text.decode().split())
