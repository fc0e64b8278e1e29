"""Finds and kills what children forked and left: by session, by marker, and as the new parent of orphans.

A fork keeps its session unless it makes its own; it keeps the environment it was started with even then. So
every child starts with `ROBBIE_CHILD=RUNID/NAME/INCARNATION`, and whoever carries it came from that child.
"""

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable, Collection, Mapping
from types import TracebackType
from typing import Self

from robbie_mp.linux.prctl import is_child_subreaper, set_child_subreaper
from robbie_mp.linux.proc import ProcessStat, environment_value, own_children, processes, read_stat
from robbie_mp.supervisor.event_loop import EventLoop

MARKER = "ROBBIE_CHILD"
MAX_PASSES = 20
END_WAIT_S = 0.5
RETRY_S = 0.05


def marker(run_id: str, name: str, incarnation: int) -> str:
    """Return the value of `MARKER` for one child."""
    return f"{run_id}/{name}/{incarnation}"


def kill_child_leftovers(session: int, child_marker: str, known: Collection[int]) -> dict[int, int]:
    """Kill whatever lives in a child's session or carries its marker, without waiting for it to be gone.

    Call it after the child has ended and before it is reaped: until then its pid, which is the number of
    its session, cannot be given to another. What a child leaves is a descendant of an orphan, and orphans
    come to the `OrphanReaper`: if there are none, nothing was left, and no process of the machine is asked.

    Args:
        session: the child's pid.
        child_marker: what `marker` returned for it.
        known: the caller's own children, this one included.

    Returns:
        A pidfd, which the caller closes, of each process that was killed, by its pid.
    """
    if own_children() <= frozenset(known):
        return {}
    leader = read_stat(session)
    since_ticks = leader.start_ticks if leader else 0  # older processes need not be asked

    def belongs(stat: ProcessStat) -> bool:
        return (
            stat.start_ticks >= since_ticks
            and stat.pid != session
            and not stat.is_dead
            and (stat.session == session or environment_value(stat.pid, MARKER) == child_marker)
        )

    return kill_all(belongs)


class Leftovers:
    """What one child has forked, from the child's end until all of that has ended, too.

    Nothing here waits: an event loop says when a process has ended, however long that takes.
    """

    def __init__(self, kill: Callable[[], dict[int, int]], loop: EventLoop, on_gone: Callable[[], None]):
        """Prepare.

        Args:
            kill: kills what is there, as `kill_child_leftovers`.
            loop: watches who was killed.
            on_gone: called once, when there is nobody left; it may be called by `end`.
        """
        self._kill = kill
        self._loop = loop
        self._on_gone = on_gone
        self._pidfds: dict[int, int] = {}
        self._is_closed = False

    @property
    def pids(self) -> tuple[int, ...]:
        """Who was killed and has not ended."""
        return tuple(self._pidfds)

    def end(self) -> None:
        """Kill what is there; again when that has ended, for it may have forked meanwhile.

        If there is no descriptor left to look for it, again a little later: nobody may be overlooked.
        """
        if self._is_closed:
            return
        try:
            self._pidfds = self._kill()
        except OSError:
            self._loop.call_later(RETRY_S, self.end)
            return
        for pid, pidfd in self._pidfds.items():
            self._loop.watch(pidfd, lambda pid=pid: self._on_end(pid))  # type: ignore[misc]
        if not self._pidfds:
            self._on_gone()

    def close(self) -> None:
        """Watch them no longer."""
        self._is_closed = True
        for pidfd in self._pidfds.values():
            self._loop.unwatch(pidfd)
            os.close(pidfd)
        self._pidfds.clear()

    def _on_end(self, pid: int) -> None:
        pidfd = self._pidfds.pop(pid)
        self._loop.unwatch(pidfd)
        os.close(pidfd)
        if not self._pidfds:
            self.end()


def kill_run_leftovers(run_id: str) -> frozenset[int]:
    """Kill whatever carries the marker of a dead run, and wait a moment for it to be gone."""
    prefix = f"{run_id}/"
    killed = kill_all(lambda stat: (environment_value(stat.pid, MARKER) or "").startswith(prefix))
    wait_gone(killed)
    return frozenset(killed)


def kill_all(belongs: Callable[[ProcessStat], bool]) -> dict[int, int]:
    """Kill all processes that belong, again until no new one shows up.

    Returns:
        A pidfd of each, which the caller closes, by its pid.

    Raises:
        OSError: there is no descriptor left, so some may have been overlooked.
    """
    killed: dict[int, int] = {}
    seen = {os.getpid()}
    try:
        for _ in range(MAX_PASSES):
            found = [p for p in processes() if p.pid not in seen and belongs(p)]
            if not found:
                break
            for process in found:
                seen.add(process.pid)
                if (pidfd := _kill(process)) is not None:
                    killed[process.pid] = pidfd
        # With none left, /proc may have seemed to know less than it does.
        os.close(os.open("/proc", os.O_RDONLY | os.O_CLOEXEC))
    except OSError:
        for pidfd in killed.values():
            os.close(pidfd)
        raise
    return killed


def wait_gone(pidfds: Mapping[int, int], timeout_s: float = END_WAIT_S) -> None:
    """Wait until these processes have ended, at most so long, and close their pidfds."""
    deadline = time.monotonic() + timeout_s
    for pidfd in pidfds.values():
        select.select([pidfd], [], [], max(0.0, deadline - time.monotonic()))
        os.close(pidfd)


def _kill(process: ProcessStat) -> int | None:
    """Kill exactly this process: the pidfd is opened first, then its start time is compared."""
    try:
        pidfd = os.pidfd_open(process.pid)
    except (ProcessLookupError, OSError):
        return None
    try:
        now = read_stat(process.pid)
        if now is not None and now.start_ticks == process.start_ticks:
            signal.pidfd_send_signal(pidfd, signal.SIGKILL)
            return pidfd
    except (ProcessLookupError, PermissionError):
        pass
    os.close(pidfd)
    return None


class OrphanReaper:
    """Takes in and reaps descendants whose own parent died, as long as it is entered.

    Children that this process had before are left alone, and so are those that the caller says it knows.
    """

    def __init__(self) -> None:
        self._was_subreaper = False
        self._foreign: frozenset[int] = frozenset()

    def __enter__(self) -> Self:
        self._was_subreaper = is_child_subreaper()
        self._foreign = own_children()
        set_child_subreaper(True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Kill and reap every orphan that is left; by now the caller has no children of its own."""
        deadline_s = time.monotonic() + END_WAIT_S
        # Again, because those whose parent is killed here come to us only then.
        while (orphans := own_children() - self._foreign) and time.monotonic() < deadline_s:
            with contextlib.suppress(OSError):  # no descriptor left for now; this is tried again
                wait_gone(kill_all(lambda stat: stat.pid in orphans))
            for pid in orphans:
                _reap(pid)
        set_child_subreaper(self._was_subreaper)

    def reap(self, known: Collection[int]) -> None:
        """Reap orphans that have ended; one system call if there are none.

        Args:
            known: the caller's own children; their exit statuses are left for the caller.
        """
        with contextlib.suppress(ChildProcessError):
            while ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if ended.si_pid in known or ended.si_pid in self._foreign:
                    return
                _reap(ended.si_pid)


def _reap(pid: int) -> None:
    with contextlib.suppress(ChildProcessError):
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG)
