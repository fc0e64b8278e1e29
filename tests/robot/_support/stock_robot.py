"""Runs the project's profiles as a user runs them."""

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

from tests._support.robot import COMMAND

PROJECT = Path(__file__).parents[3]


class StockRobot:
    """Runs profiles of the project, with everything they write in a temporary folder."""

    def __init__(self, folder: Path, workspace: Path = PROJECT) -> None:
        self.output = folder / "out"
        self._workspace = workspace
        self._environment = dict(os.environ, XDG_RUNTIME_DIR=str(folder), PYTHONPATH=str(PROJECT))
        self._process: subprocess.Popen[str] | None = None

    def start(self, *arguments: str, command: str = "run") -> None:
        self._process = subprocess.Popen(
            [*COMMAND, command, *arguments, "--json", "--output", str(self.output)],
            cwd=self._workspace,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def wait(self, timeout_s: float) -> tuple[int, dict[str, dict[str, Any]], str]:
        """Exit code, modules of the summary, standard error."""
        assert self._process is not None
        stdout, stderr = self._process.communicate(timeout=timeout_s)
        summary = json.loads(stdout) if stdout else {"modules": []}
        return self._process.returncode, {module["name"]: module for module in summary["modules"]}, stderr

    def run(self, *arguments: str, timeout_s: float = 120.0) -> tuple[int, dict[str, dict[str, Any]], str]:
        self.start(*arguments)
        return self.wait(timeout_s)

    def play(self, log: Path, *arguments: str) -> tuple[int, dict[str, dict[str, Any]], str]:
        """Play a log; the output is in another folder then."""
        self.output = self.output.with_name(f"{log.stem}-{arguments[0]}")
        self.start(str(log), *arguments, command="play")
        return self.wait(300.0)

    def top(self) -> dict[str, dict[str, Any]]:
        answer = subprocess.run(
            [*COMMAND, "top", "--once", "--json"],
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return {
            module["name"]: module for module in json.loads(answer.stdout or '{"modules": []}')["modules"]
        }

    def attach(self, *arguments: str) -> subprocess.Popen[str]:
        """Start a command that attaches to the run."""
        return subprocess.Popen(
            [*COMMAND, *arguments],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            self._process.communicate(timeout=30)
