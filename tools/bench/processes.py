"""Processor time of processes, as the kernel's scheduler counts it, and their names in /dev/shm."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

import psutil

FOLDER = "/dev/shm/"


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


def memory_bytes(pids: Iterable[int]) -> int:
    """Return the memory of processes; each page counts once, however many of them share it.

    Source: `Pss` of smaps_rollup in proc(5), which divides a page by those who have it mapped.
    """
    total = 0
    for pid in pids:
        with contextlib.suppress(psutil.Error):  # the process has just ended
            total += psutil.Process(pid).memory_full_info().pss
    return total


def family(*pids: int) -> list[int]:
    """Return processes and all their descendants, from one pass over the process table."""
    children: dict[int, list[int]] = {}
    for process in psutil.process_iter(["ppid"]):
        children.setdefault(process.info["ppid"], []).append(process.pid)
    found = list(pids)
    for pid in found:  # the list grows during the loop
        found += children.get(pid, [])
    return found


def mapped_names(pids: Iterable[int]) -> set[Path]:
    """Return the names that processes have mapped, including those of semaphores."""
    names = set()
    for pid in pids:
        with contextlib.suppress(OSError):  # the process has ended, or belongs to another user
            for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
                _, found, name = line.partition(FOLDER)
                if found:
                    names.add(Path(FOLDER + name.removesuffix(" (deleted)")))
    return names


def remove_unmapped(names: Iterable[Path]) -> None:
    """Remove those of the names that no process has mapped."""
    for name in set(names) - mapped_names(psutil.pids()):
        name.unlink(missing_ok=True)
