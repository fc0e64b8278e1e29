"""Processor time of processes in nanoseconds, as the kernel's scheduler counts it."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

import psutil


def thread_times_ns(pids: Iterable[int]) -> dict[Path, int]:
    """Return the processor time that each thread of these processes has used so far, in ns.

    Source: proc(5). The first number in /proc/PID/task/TID/schedstat is the time on a processor.
    """
    found = {}
    for pid in pids:
        for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            with contextlib.suppress(OSError):  # the thread has just ended
                found[file] = int(file.read_text().split()[0])
    return found


def measure_cpu_ns(pids: Iterable[int], window_s: float) -> int:
    """Wait, and return the processor time used meanwhile, in ns. Threads that end meanwhile do not count."""
    processes = list(pids)
    before = thread_times_ns(processes)
    time.sleep(window_s)
    return sum(ns - before.get(thread, 0) for thread, ns in thread_times_ns(processes).items())


def family(*pids: int) -> list[int]:
    """Return processes and all their descendants, from one pass over the process table."""
    children: dict[int, list[int]] = {}
    for process in psutil.process_iter(["ppid"]):
        children.setdefault(process.info["ppid"], []).append(process.pid)
    found = list(pids)
    for pid in found:  # the list grows during the loop
        found += children.get(pid, [])
    return found


def process_ns(pid: int) -> int:
    """Return the processor time that the threads of one process have used so far, in ns."""
    return sum(thread_times_ns([pid]).values())
