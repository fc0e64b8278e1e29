"""Runs `robbie_mp.run.profile.check` in a process that cannot harm its caller, and reads its results."""

import json
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.pidfd import open_process
from robbie_mp.base.linux.python_command import python_command
from robbie_mp.run.profile.model import ModuleSpec, Profile

START_TIME_S = 30.0
"""How long the checking process may take to start, in s: on a busy machine that is no module's fault."""
CLOSING_TIME_S = 2.0
"""How long the checking process may keep running after it has closed its output, in s."""


class PreflightError(RobbieError, RuntimeError):
    """The checking process itself failed; nothing is known about the profile."""


def check_events(
    profile: Profile, modules: Sequence[ModuleSpec], timeout_s: float, base_class: str
) -> Generator[dict[str, Any], None, None]:
    """Run one checking process and yield its events.

    Yields:
        For each module `{"begin": name}`, then `{"result": {"errors": [[key, text]…], "flaws": [[file, line,
        text]…], "settings": {…}, "failure": traceback or "", "missing": whether that is an ImportError,
        "saves_state": whether it calls `checkpoint`,
        "handler_deadline_s": the deadline of its class, or null,
        "types": [[name, version, schema]…]}}`; at last `{"end": True}`, or `{"broken": how it ended}`, or
        `{"useless": traceback}` if the base class cannot be imported.
    """
    request = {
        "asked_by": os.getpid(),
        "workspace": str(profile.workspace),
        "base_class": base_class,
        "timeout_s": timeout_s,
        "names": [module.name for module in profile.modules],
        "modules": [
            question_about(module) | {"removed": profile.removed_settings(module.name)} for module in modules
        ],
    }
    with _checking_process(request) as process:
        assert process.stdout
        for line in _lines(process.stdout, timeout_s):
            if line is None:
                yield {"broken": f"did not finish within {timeout_s:g} s"}
                return
            event = json.loads(line)
            if "ready" in event:
                continue
            yield event
            if "end" in event or "useless" in event:
                return
        yield {"broken": _how_it_ended(process)}


def question_about(module: ModuleSpec) -> dict[str, Any]:
    """Return what `robbie_mp.run.profile.check.examine` must know about a module."""
    known = ("name", "class_path", "code", "settings", "folder_of")
    return {name: getattr(module, name) for name in known}


@contextmanager
def _checking_process(request: dict[str, Any]) -> Iterator[subprocess.Popen[bytes]]:
    """Start the process; at the end kill it and all processes that it started."""
    package_root = str(Path(__file__).parents[3])
    search_path = os.pathsep.join(filter(None, [package_root, os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryFile("w+") as request_file:
        json.dump(request, request_file, default=str)
        request_file.seek(0)
        process = subprocess.Popen(
            python_command("robbie_mp.run.profile.check"),
            stdin=request_file,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": search_path},
            start_new_session=True,
        )
    with process:
        try:
            yield process
        finally:
            _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and its children; its process id is not reused until it is waited for."""
    if process.returncode is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _lines(stream: IO[bytes], timeout_s: float) -> Iterator[bytes | None]:
    """Yield each line of a pipe; None for a line that is not in time. The first line has its own limit."""
    poll = select.poll()
    poll.register(stream, select.POLLIN)
    pending = b""
    limit_s = max(timeout_s, START_TIME_S)
    while True:
        deadline = time.monotonic() + limit_s
        limit_s = timeout_s
        while b"\n" not in pending:
            if not poll.poll(max(0.0, deadline - time.monotonic()) * 1000):
                yield None
                return
            chunk = os.read(stream.fileno(), 65536)
            if not chunk:
                return
            pending += chunk
        line, _, pending = pending.partition(b"\n")
        yield line


def _how_it_ended(process: subprocess.Popen[bytes]) -> str:
    """Return in words how a process ended that has closed its output."""
    ending = open_process(process.pid)
    try:
        poll = select.poll()
        poll.register(ending, select.POLLIN)
        poll.poll(CLOSING_TIME_S * 1000)
    finally:
        os.close(ending)
    _kill(process)
    if process.returncode >= 0:
        return f"ended with exit code {process.returncode}"
    return f"was killed by {signal.Signals(-process.returncode).name}"
