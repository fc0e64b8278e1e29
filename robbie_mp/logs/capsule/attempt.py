"""Runs something that may crash, hang or fill the memory, in a forked process, and returns how it ended."""

import faulthandler
import json
import mmap
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from robbie_mp.base.linux.prctl import die_with_parent
from robbie_mp.logs.capsule.place import EXIT, HANG, SIGNAL, Crash, dumped_place, raised_crash
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames

LIMIT_S = 5.0
"""One step may take this long; beyond it, it hangs."""
START_LIMIT_S = 20.0
"""The same for imports and setup."""
DUMP_S = 2.0
"""A process that hangs has this long to print its stacks."""
POLL_S = 0.05
MOST_OUTCOME_BYTES = 1 << 20


class Progress:
    """A number that a forked process shows."""

    def __init__(self) -> None:
        self._shared = mmap.mmap(-1, 8)

    def show(self, number: int) -> None:
        """Show a number."""
        self._shared[:] = (number + 1).to_bytes(8, "little")

    @property
    def number(self) -> int:
        """The number shown last; -1: none was shown yet."""
        return int.from_bytes(self._shared[:], "little") - 1


@dataclass
class Outcome:
    """How an attempt ended.

    Attributes:
        crash: how.
        step: the step that was being run.
        details: what the attempt returned or noted.
    """

    crash: Crash
    step: int
    details: dict[str, Any] = field(default_factory=dict)


Act = Callable[[Progress, dict[str, Any]], None]


def attempt(act: Act, *, limit_s: float = LIMIT_S, quiet: bool = True) -> Outcome:
    """Run something in a forked process.

    Args:
        act: gets a progress to show, and a place for details that are returned even if it raises.
        limit_s: it hangs when it shows no progress for this long.
        quiet: whether what it prints is dropped.
    """
    progress = Progress()
    dump = os.memfd_create("robbie-replay")
    read_end, write_end = os.pipe()
    parent = os.getpid()
    pid = os.fork()
    if pid == 0:
        os.close(read_end)
        _run(act, progress, write_end, dump, parent, quiet=quiet)
    os.close(write_end)
    try:
        said, hangs = _wait(pid, read_end, progress, limit_s)
        _, status = os.waitpid(pid, 0)
        lines = os.pread(dump, MOST_OUTCOME_BYTES, 0).decode(errors="replace").splitlines()
    finally:
        os.close(read_end)
        os.close(dump)
    return _outcome(said, status, lines, max(0, progress.number), hangs=hangs)


def _run(act: Act, progress: Progress, to: int, dump: int, parent: int, *, quiet: bool) -> None:
    """Be the forked process; never returns."""
    crash = Crash("end")
    details: dict[str, Any] = {}
    try:
        die_with_parent(parent)
        os.setpgid(0, 0)
        if quiet:
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 1)
            os.dup2(nothing, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        faulthandler.enable(dump)
        act(progress, details)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        crash = Crash(EXIT, str(code)) if code else crash
    except BaseException as error:
        leave_out_our_frames(error)
        crash = raised_crash(error)
    finally:
        text = json.dumps({"crash": crash.to_dict(), "details": details}, default=str).encode()
        os.write(to, text[: 1 << 16])
        sys.stdout.flush()
        os._exit(0)


def _wait(pid: int, read_end: int, progress: Progress, limit_s: float) -> tuple[bytes, bool]:
    said, seen, since_s = b"", progress.number, time.monotonic()
    hangs = False
    while True:
        if select.select([read_end], [], [], POLL_S)[0]:
            piece = os.read(read_end, 1 << 16)
            if not piece:
                return said, hangs
            said += piece
            continue
        now_s = time.monotonic()
        # The setup may load a model, unless the user has given another limit. Imports always have this time.
        is_start = seen < 0 or (seen == 0 and limit_s == LIMIT_S)
        allowed_s = max(limit_s, START_LIMIT_S) if is_start else limit_s
        if progress.number != seen:
            seen, since_s = progress.number, now_s
        elif not hangs and now_s - since_s > allowed_s:
            hangs = True
            os.kill(pid, signal.SIGABRT)
        elif hangs and now_s - since_s > allowed_s + DUMP_S:
            os.kill(pid, signal.SIGKILL)


def _outcome(said: bytes, status: int, lines: list[str], step: int, *, hangs: bool) -> Outcome:
    if hangs:
        return Outcome(Crash(HANG, "", "", dumped_place(lines)), step)
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return Outcome(Crash(SIGNAL, name, "", dumped_place(lines)), step)
    try:
        found = json.loads(said)
        return Outcome(Crash.from_dict(found["crash"]), step, found["details"])
    except (ValueError, KeyError):
        return Outcome(Crash(EXIT, str(os.WEXITSTATUS(status))), step)
