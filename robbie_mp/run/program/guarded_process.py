"""A program's process with its guardian, and what it prints."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from robbie_mp.base.linux.proc import processes, read_usage
from robbie_mp.run.program import guardian
from robbie_mp.run.program.guardian import CANNOT_START, END_WAIT_S, SIGNALLED, STOP

MAX_LINE_BYTES = 1 << 16
"""A longer line is looked at in pieces."""


class LineWatch:
    """Passes on what a program prints, and notes when a line held a text.

    Args:
        texts: the texts.

    Attributes:
        seen_s: for each text, when a line last held it, in monotonic time.
    """

    def __init__(self, texts: Sequence[str]):
        self.seen_s: dict[str, float] = {}
        self._texts = tuple(texts)

    def follow(self, source: IO[bytes], target: int) -> threading.Thread:
        """Pass on each line to a descriptor, in a thread that ends with the source."""
        thread = threading.Thread(target=self._pass_on, args=(source, target), daemon=True)
        thread.start()
        return thread

    def _pass_on(self, source: IO[bytes], target: int) -> None:
        with source:
            while line := source.readline(MAX_LINE_BYTES):
                printed = line.decode("utf-8", "replace")
                # Not regular expressions: some take for ever over a line that a program chooses.
                self.seen_s |= {text: time.monotonic() for text in self._texts if text in printed}
                os.write(target, line)


class GuardedProcess:
    """A program that runs.

    Args:
        command: the program and its arguments.
        environment: the whole environment.
        folder: its working directory; None: this process's.
        stop_signal: asks it to end.
        grace_s: time until it is killed then.
        watch: sees what it prints; None: that goes where this process prints.
    """

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        folder: Path | None,
        stop_signal: signal.Signals,
        grace_s: float,
        watch: LineWatch | None,
    ):
        start = [sys.executable, "-I", "-S", guardian.__file__, str(int(stop_signal)), str(grace_s)]
        output = None if watch is None else subprocess.PIPE
        self._grace_s = grace_s
        self._popen = subprocess.Popen(
            [*start, *command],
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=output,
            env=environment,
            cwd=folder,
        )
        self._threads: list[threading.Thread] = []
        if watch is not None:
            assert self._popen.stdout is not None
            assert self._popen.stderr is not None
            self._threads = [watch.follow(self._popen.stdout, 1), watch.follow(self._popen.stderr, 2)]

    @property
    def code(self) -> int | None:
        """Its exit code, as a shell has it; None while it runs. Then nothing of its tree is left."""
        return self._popen.poll()

    def stop(self) -> None:
        """Ask it to end, kill what has not ended in time, and wait for that."""
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError, ValueError), self._popen.stdin as pipe:
            pipe.write(STOP)
            pipe.flush()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._popen.wait(self._grace_s + END_WAIT_S)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(END_WAIT_S)
        for thread in self._threads:
            thread.join(END_WAIT_S)

    def usage(self) -> tuple[int, float, int]:
        """Return how many processes its tree has, their processor time (s), and their memory (bytes)."""
        parents = {one.pid: one.parent for one in processes() if not one.is_dead}
        found, new = set[int](), {self._popen.pid}
        while new := {pid for pid, parent in parents.items() if parent in new} - found:
            found |= new
        usages = [read_usage(pid) for pid in found]
        return len(found), sum(one.cpu_s for one in usages), sum(one.rss_bytes for one in usages)


def outcome(code: int) -> str:
    """Return in words how a program ended."""
    if code == CANNOT_START:
        return "it cannot be started"
    number = -code if code < 0 else code - SIGNALLED
    with contextlib.suppress(ValueError):
        return f"killed by {signal.Signals(number).name}"
    return f"exit code {code}"
