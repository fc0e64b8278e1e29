"""Processor time of processes, to the nanosecond, as the kernel's scheduler counts it."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

import psutil


def thread_times_ns(pids: Iterable[int]) -> dict[Path, int]:
    """Return what each thread of these processes has run, in ns.

    Source: proc(5), /proc/PID/task/TID/schedstat, whose first number is the time on a processor.
    """
    found = {}
    for pid in pids:
        for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # a thread that has just ended
                found[file] = int(file.read_text().split()[0])
    return found


def measure_cpu_ns(pids: Iterable[int], window_s: float) -> int:
    """Return what these processes run during a while, in ns; without threads that end meanwhile."""
    processes = list(pids)
    before = thread_times_ns(processes)
    time.sleep(window_s)
    return sum(ns - before.get(thread, 0) for thread, ns in thread_times_ns(processes).items())


def family(*pids: int) -> list[int]:
    """Return processes and all that descend from them, from one look at all processes."""
    children: dict[int, list[int]] = {}
    for process in psutil.process_iter(["ppid"]):
        children.setdefault(process.info["ppid"], []).append(process.pid)
    found = list(pids)
    for pid in found:  # which grows meanwhile
        found += children.get(pid, [])
    return found


def process_ns(pid: int) -> int:
    """Return what the threads of one process have run, in ns."""
    return sum(thread_times_ns([pid]).values())
