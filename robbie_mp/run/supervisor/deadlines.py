"""Time that counts against a deadline, and the watch for children that hang.

Two kinds of time do not count: while the whole machine was stopped (`RunningTime`), and while a child waited
for a processor (`RunQueueTime`).
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.bus.transport.layout import Activity
from robbie_mp.run.supervisor.incarnations import Doing

MAX_STEP_S = 0.25
"""The event loop reads the time more than twice as often, unless this process is not running at all."""


class RunningTime:
    """Time in s that passes only while this process runs.

    A closed lid, a paused virtual machine or a frozen container stops all processes together, so all are late
    by the same time and none has missed a deadline. Such a pause counts as `MAX_STEP_S` at most.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        """Start at the clock's time.

        Args:
            clock: monotonic time in s.
        """
        self._clock = clock
        self._seen_s = self._time_s = clock()

    def __call__(self) -> float:
        """Return the time in s. Call this often, at least twice in `MAX_STEP_S`."""
        now_s = self._clock()
        self._time_s += min(now_s - self._seen_s, MAX_STEP_S)
        self._seen_s = now_s
        return self._time_s


PROC = Path("/proc")
READ_PERIOD_S = 0.1


@dataclass
class _Thread:
    """One thread: what the kernel had counted at the first reading, and the last change seen."""

    waited_ns: int
    """Time in the run queue at the first reading; only what the kernel adds later counts."""
    seen: tuple[int, int]
    """Time on a processor and time in the run queue (ns) at the last reading."""
    seen_s: float


class RunQueueTime:
    """The time for which a thread of a process was ready to run but had no processor.

    The thread that waited longest counts. All threads are read, not only the main thread: a handler may
    wait for its own threads, for one that holds the GIL, or for a library's pool, and those may be the ones
    without a processor.

    The kernel adds the time in the queue when a thread leaves it (run_delay in /proc/PID/task/TID/schedstat).
    So a thread that is ready (state R) and has not changed since a reading counts as waiting since then.
    """

    def __init__(self, pid: int, proc: Path = PROC):
        """Prepare; call `begin` first.

        Args:
            pid: the process.
            proc: where proc(5) is mounted.
        """
        self._tasks = f"{proc}/{pid}/task"
        self._threads: dict[str, _Thread] = {}
        self._looked_s = float("-inf")
        self._waited_s = 0.0

    def begin(self, now_s: float) -> None:
        """Count from now on.

        Args:
            now_s: monotonic time in s, from the same clock in all calls.
        """
        self._threads.clear()
        self._look(now_s, is_first=True)

    def waited_s(self, now_s: float) -> float:
        """Return how long the longest-waiting thread has waited since `begin`; cheap to call often."""
        if now_s - self._looked_s >= READ_PERIOD_S:
            self._look(now_s, is_first=False)
        return self._waited_s

    def _look(self, now_s: float, *, is_first: bool) -> None:
        self._looked_s = now_s
        self._waited_s = 0.0
        for name in _names(self._tasks):
            if (figures := _figures(f"{self._tasks}/{name}")) is None:
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


def _names(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []  # it has ended


def _figures(folder: str) -> tuple[str, int, int] | None:
    """Return a thread's state, processor time and run-queue time (ns); None if it has ended."""
    try:
        with open(f"{folder}/stat", "rb") as file:
            stat = file.read()
        with open(f"{folder}/schedstat", "rb") as file:
            schedstat = file.read()
    except OSError:
        return None  # it has ended, or the kernel does not count
    ran_ns, waited_ns, _ = map(int, schedstat.split())
    return stat.rpartition(b")")[2].split()[0].decode(), ran_ns, waited_ns


UNWATCHED_SHARE = 0.05
"""The share of its deadline that an activity may take before the run queue is read."""


class HangWatch:
    """Checks repeatedly what one child is doing, and detects when it does the same thing for too long.

    The time runs from the first check that finds an activity to the last check that still finds the same one.
    So a healthy child cannot look hung because a word changed between two reads or because its clock differs.
    Nor does an overloaded machine make it look hung: time spent waiting for a processor does not count.
    """

    def __init__(self, deadline_s: float, teardown_deadline_s: float):
        """Set the deadlines.

        Args:
            deadline_s: how long any activity except the teardown may take; 0: without limit.
            teardown_deadline_s: how long the teardown may take, if that is longer; it may write a large map.
        """
        self._deadline_s = deadline_s
        self._teardown_deadline_s = max(deadline_s, teardown_deadline_s)
        self._doing: Doing | None = None
        self._since_s = 0.0
        self._is_queue_watched = False

    def hung_for_s(self, doing: Doing | None, now_s: float, run_queue: RunQueueTime) -> float | None:
        """Return for how long the child has been hung in its activity; None if it is not hung.

        Args:
            doing: what the child is doing now; None: nothing, and no work waits for it.
            now_s: running time in s; see `RunningTime`.
            run_queue: measures how long the child waits for a processor; no other caller may use it.
        """
        if doing is None or doing != self._doing:
            self._doing = doing
            self._since_s = now_s
            self._is_queue_watched = False
            return None
        in_teardown = doing.activity is Activity.TEARDOWN
        deadline_s = self._teardown_deadline_s if in_teardown else self._deadline_s
        passed_s = now_s - self._since_s
        if not self._deadline_s or passed_s < UNWATCHED_SHARE * deadline_s:
            return None
        if not self._is_queue_watched:
            self._is_queue_watched = True
            run_queue.begin(now_s)
        if passed_s < deadline_s or passed_s - run_queue.waited_s(now_s) < deadline_s:
            return None
        return passed_s
