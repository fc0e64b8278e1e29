"""Process information from proc(5): the few fields that supervision and cleaning up need."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from typing_extensions import Self


@dataclass(frozen=True)
class ProcessIdentity:
    """A process's pid and start time, which together identify it for good; a pid alone is reused."""

    pid: int
    start_ticks: int
    """Start in clock ticks since boot."""

    @classmethod
    def own(cls) -> Self:
        """Return the identity of this process.

        Raises:
            OSError: /proc is not mounted, or there is no file descriptor left.
        """
        try:
            stat = _parse_stat(os.getpid(), _read_stat(os.getpid()))
        except FileNotFoundError as error:
            raise FileNotFoundError(
                "/proc/self/stat is missing; mount /proc, supervision needs it"
            ) from error
        return cls(stat.pid, stat.start_ticks)

    @property
    def is_alive(self) -> bool:
        """Whether this process still runs; a zombie does not."""
        stat = read_stat(self.pid)
        return stat is not None and stat.start_ticks == self.start_ticks and not stat.is_dead


@dataclass(frozen=True)
class ProcessStat:
    """One line of /proc/PID/stat."""

    pid: int
    state: str
    """One letter, as in ps(1)."""
    parent: int
    session: int
    start_ticks: int
    cpu_ticks: int
    """Processor time in user and kernel mode, in clock ticks."""

    @property
    def is_dead(self) -> bool:
        """Whether it has ended and only waits to be reaped."""
        return self.state in "ZX"


def read_stat(pid: int) -> ProcessStat | None:
    """Return a process's line of /proc/PID/stat, None if there is no such process."""
    try:
        return _parse_stat(pid, _read_stat(pid))
    except OSError:
        return None  # gone, or hidden from us


def has_ended(pid: int) -> bool:
    """Return whether all threads of a process have ended: at most its zombie is left."""
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return True
    return all(stat.is_dead for thread in threads if (stat := read_stat(int(thread))))


def _read_stat(pid: int) -> bytes:
    with open(f"/proc/{pid}/stat", "rb") as file:
        return file.read()


def _parse_stat(pid: int, text: bytes) -> ProcessStat:
    # The command's name, in parentheses, may contain spaces and parentheses: split after the last one.
    fields = text.rpartition(b")")[2].split()
    cpu_ticks = int(fields[11]) + int(fields[12])
    return ProcessStat(pid, fields[0].decode(), int(fields[1]), int(fields[3]), int(fields[19]), cpu_ticks)


def read_wait_channel(pid: int) -> str:
    """Return the kernel function in which a process sleeps; '' if it is awake or the kernel hides it."""
    try:
        with open(f"/proc/{pid}/wchan") as file:
            name = file.read()
    except OSError:
        return ""
    return "" if name == "0" else name


def is_traced(pid: int) -> bool:
    """Whether a debugger such as gdb is attached to a process (ptrace(2))."""
    try:
        with open(f"/proc/{pid}/status", "rb") as file:
            return any(line.startswith(b"TracerPid:") and line.split()[1] != b"0" for line in file)
    except OSError:
        return False


_USAGE = re.compile(rb"^(VmRSS|RssShmem|Threads|voluntary_ctxt_switches):\s*(\d+)", re.MULTILINE)


@dataclass(frozen=True)
class ProcessUsage:
    """Processor time, memory and threads of a process; zeros if it has ended."""

    cpu_s: float = 0.0
    """Processor time in user and kernel mode."""
    rss_bytes: int = 0
    """Resident memory."""
    shared_bytes: int = 0
    """Shared memory, as part of `rss_bytes`."""
    threads: int = 0
    wakeups: int = 0
    """How often its threads have waited for something, and were woken."""


def read_usage(pid: int) -> ProcessUsage:
    """Return the resource usage of a process."""
    stat = read_stat(pid)
    found = _read_status(f"/proc/{pid}/status")
    if stat is None or not found:
        return ProcessUsage()
    statuses = [found]
    if found[b"Threads"] != b"1":  # the process's own status has the wake-ups of its main thread
        statuses = [_read_status(str(file)) for file in Path(f"/proc/{pid}/task").glob("*/status")]
    return ProcessUsage(
        cpu_s=stat.cpu_ticks / os.sysconf("SC_CLK_TCK"),
        rss_bytes=int(found.get(b"VmRSS", 0)) << 10,  # a zombie has none
        shared_bytes=int(found.get(b"RssShmem", 0)) << 10,
        threads=int(found[b"Threads"]),
        wakeups=sum(int(status.get(b"voluntary_ctxt_switches", 0)) for status in statuses),
    )


def _read_status(file: str) -> dict[bytes, bytes]:
    try:
        with open(file, "rb") as opened:
            return dict(_USAGE.findall(opened.read()))
    except OSError:
        return {}


def processes() -> Iterator[ProcessStat]:
    """Yield every process of the machine, except those that end meanwhile."""
    for name in os.listdir("/proc"):
        if name.isdecimal() and (stat := read_stat(int(name))) is not None:
            yield stat


def environment_value(pid: int, variable: str) -> str | None:
    """Return an environment variable that a process started with; None if unset or unreadable."""
    try:
        with open(f"/proc/{pid}/environ", "rb") as file:
            entries = file.read().split(b"\0")
    except OSError:
        return None  # gone, or another user's
    prefix = f"{variable}=".encode()
    return next((os.fsdecode(entry[len(prefix) :]) for entry in entries if entry.startswith(prefix)), None)


def own_children() -> frozenset[int]:
    """Return the pids of this process's children, including zombies.

    The result is complete as long as no other thread of this process reaps children meanwhile.
    """
    found: list[str] = []
    try:
        for thread in os.listdir("/proc/self/task"):
            with open(f"/proc/self/task/{thread}/children") as file:
                found += file.read().split()
    except FileNotFoundError:  # a thread that just ended, or a kernel without CONFIG_PROC_CHILDREN
        return frozenset(stat.pid for stat in processes() if stat.parent == os.getpid())
    return frozenset(map(int, found))
