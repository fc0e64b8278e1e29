"""How long a process has waited for a processor: time in which it could do nothing."""

import os
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
LOOK_EVERY_S = 0.1


@dataclass
class _Thread:
    """One thread at its first look, and since it was last seen to change."""

    waited_ns: int
    """Until then; what the kernel counts later has come since."""
    seen: tuple[int, int]
    """Time on a processor and time in the run queue (ns), as the kernel last said."""
    seen_s: float


class RunQueueTime:
    """The time for which a process had a thread ready to run, and no processor for it.

    The thread that waited longest is what counts. All are looked at, not only the main thread: a handler may
    wait for threads of its own, for the GIL that one of them holds, or for a pool of a library, and these may
    be the ones that get no processor.

    The kernel adds the time in the queue when a thread leaves it (run_delay in /proc/PID/task/TID/schedstat).
    So a thread that is ready (state R) and has not moved since the look before counts as waiting since then.
    """

    def __init__(self, pid: int, proc: Path = PROC):
        """Prepare; `begin` comes first.

        Args:
            pid: of the process.
            proc: where proc(5) is.
        """
        self._tasks = proc / str(pid) / "task"
        self._threads: dict[str, _Thread] = {}
        self._looked_s = float("-inf")
        self._waited_s = 0.0

    def begin(self, now_s: float) -> None:
        """Count from now on.

        Args:
            now_s: a time that never goes back, the same for all calls.
        """
        self._threads.clear()
        self._look(now_s, is_first=True)

    def waited_s(self, now_s: float) -> float:
        """Return how long the thread that waited longest has waited since `begin`; costs little if often."""
        if now_s - self._looked_s >= LOOK_EVERY_S:
            self._look(now_s, is_first=False)
        return self._waited_s

    def _look(self, now_s: float, *, is_first: bool) -> None:
        self._looked_s = now_s
        self._waited_s = 0.0
        for name in _names(self._tasks):
            if (figures := _figures(self._tasks / name)) is None:
                continue
            state, ran_ns, waited_ns = figures
            thread = self._threads.get(name)
            if thread is None:
                thread = _Thread(waited_ns if is_first else 0, (ran_ns, waited_ns), now_s)
                self._threads[name] = thread
            if thread.seen != (ran_ns, waited_ns) or state != "R":
                thread.seen, thread.seen_s = (ran_ns, waited_ns), now_s
            counted_s = (waited_ns - thread.waited_ns) / 1e9 + (now_s - thread.seen_s)
            self._waited_s = max(self._waited_s, counted_s)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []  # it has ended


def _figures(folder: Path) -> tuple[str, int, int] | None:
    """Return state, time on a processor and time in the run queue (ns) of a thread; None if there is none."""
    try:
        stat = (folder / "stat").read_bytes()
        schedstat = (folder / "schedstat").read_bytes()
    except OSError:
        return None  # it has ended, or the kernel does not count
    ran_ns, waited_ns, _ = map(int, schedstat.split())
    return stat.rpartition(b")")[2].split()[0].decode(), ran_ns, waited_ns
