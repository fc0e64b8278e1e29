"""Processor time of processes, to the nanosecond, as the kernel's scheduler counts it."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import psutil


def cpu_ns(pids: Iterable[int]) -> int:
    """Return what all threads of these processes have run, in ns.

    Source: proc(5), /proc/PID/task/TID/schedstat, whose first number is the time on a processor.
    """
    total = 0
    for pid in pids:
        for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # a thread that has just ended
                total += int(file.read_text().split()[0])
    return total


def family(pid: int) -> list[int]:
    """Return a process and all that descend from it."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return [pid, *(child.pid for child in psutil.Process(pid).children(recursive=True))]
    return []
