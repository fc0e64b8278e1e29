"""Finds and kills the processes that children forked and left behind.

They are found by session, by marker, and because the supervisor becomes the parent of orphans. A forked
process keeps its session unless it creates a new one; even then it keeps the environment. Every child starts
with `ROBBIE_CHILD=RUNID/NAME/INCARNATION`, so a process with this marker descends from that child.
"""

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable, Collection, Mapping
from types import TracebackType

from typing_extensions import Self

from robbie_mp.base.linux.pidfd import open_process, send_signal
from robbie_mp.base.linux.prctl import is_child_subreaper, set_child_subreaper
from robbie_mp.base.linux.proc import ProcessStat, environment_value, own_children, processes, read_stat
from robbie_mp.run.supervisor.event_loop import EventLoop

MARKER = "ROBBIE_CHILD"
MAX_PASSES = 20
END_WAIT_S = 0.5
RETRY_S = 0.05


def marker(run_id: str, name: str, incarnation: int) -> str:
    """Return the value of `MARKER` for one child."""
    return f"{run_id}/{name}/{incarnation}"


def kill_child_leftovers(session: int, child_marker: str, known: Collection[int]) -> dict[int, int]:
    """Kill all processes in a child's session or with its marker, without waiting for them to end.

    Call this after the child has ended and before it is reaped. Until then its pid, which is also its session
    number, cannot be reused. Whatever a child leaves behind descends from an orphan, and the `OrphanReaper`
    adopts orphans. If there are none, nothing was left, and /proc is not searched.

    Args:
        session: the child's pid.
        child_marker: the value that `marker` returned for the child.
        known: the caller's own children, including this one.

    Returns:
        The pidfd of each killed process, by its pid. The caller closes them.
    """
    if own_children() <= frozenset(known):
        return {}
    leader = read_stat(session)
    since_ticks = leader.start_ticks if leader else 0  # older processes cannot descend from it

    def belongs(stat: ProcessStat) -> bool:
        return (
            stat.start_ticks >= since_ticks
            and stat.pid != session
            and not stat.is_dead
            and (stat.session == session or environment_value(stat.pid, MARKER) == child_marker)
        )

    return kill_all(belongs)


class Leftovers:
    """The processes that one child forked, from the child's end until all of them have ended.

    Nothing here blocks: the event loop reports when a process has ended, however long that takes.
    """

    def __init__(self, kill: Callable[[], dict[int, int]], loop: EventLoop, on_gone: Callable[[], None]):
        """Prepare.

        Args:
            kill: kills the processes, like `kill_child_leftovers`.
            loop: watches the killed processes.
            on_gone: called once, when no process is left; `end` itself may call it.
        """
        self._kill = kill
        self._loop = loop
        self._on_gone = on_gone
        self._pidfds: dict[int, int] = {}
        self._is_closed = False

    @property
    def pids(self) -> tuple[int, ...]:
        """Processes that were killed and have not ended yet."""
        return tuple(self._pidfds)

    def end(self) -> None:
        """Kill the processes; repeat when they have ended, because they may have forked meanwhile.

        If no descriptor is left for the search, try again a little later, so that none is overlooked.
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
        """Stop watching them."""
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
    """Kill all processes with the marker of a dead run, and wait up to `END_WAIT_S` for their end."""
    prefix = f"{run_id}/"
    killed = kill_all(lambda stat: (environment_value(stat.pid, MARKER) or "").startswith(prefix))
    wait_gone(killed)
    return frozenset(killed)


def kill_all(belongs: Callable[[ProcessStat], bool]) -> dict[int, int]:
    """Kill all processes for which `belongs` is true; repeat until no new one is found.

    Returns:
        The pidfd of each killed process, by its pid. The caller closes them.

    Raises:
        OSError: no descriptor is left, so some processes may have been overlooked.
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
        # If no descriptor is left, the search of /proc may have missed processes.
        os.close(os.open("/proc", os.O_RDONLY | os.O_CLOEXEC))
    except OSError:
        for pidfd in killed.values():
            os.close(pidfd)
        raise
    return killed


def wait_gone(pidfds: Mapping[int, int], timeout_s: float = END_WAIT_S) -> None:
    """Wait until these processes have ended, at most `timeout_s`, and close their pidfds."""
    deadline = time.monotonic() + timeout_s
    for pidfd in pidfds.values():
        select.select([pidfd], [], [], max(0.0, deadline - time.monotonic()))
        os.close(pidfd)


def _kill(process: ProcessStat) -> int | None:
    """Kill exactly this process: open its pidfd first, then compare the start time."""
    try:
        pidfd = open_process(process.pid)
    except (ProcessLookupError, OSError):
        return None
    try:
        now = read_stat(process.pid)
        if now is not None and now.start_ticks == process.start_ticks:
            send_signal(pidfd, signal.SIGKILL)
            return pidfd
    except (ProcessLookupError, PermissionError):
        pass
    os.close(pidfd)
    return None


class OrphanReaper:
    """While entered, adopts and reaps descendants whose own parent has died.

    Children that this process had before are left alone, and so are the children that the caller names.
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
        """Kill and reap every remaining orphan. By now the caller has no children."""
        deadline_s = time.monotonic() + END_WAIT_S
        # Repeat: killing a parent here makes its children orphans.
        while (orphans := own_children() - self._foreign) and time.monotonic() < deadline_s:
            with contextlib.suppress(OSError):  # no descriptor is left; try again
                wait_gone(kill_all(lambda stat: stat.pid in orphans))
            for pid in orphans:
                _reap(pid)
        set_child_subreaper(self._was_subreaper)

    def reap(self, known: Collection[int]) -> None:
        """Reap orphans that have ended; this takes one system call if there are none.

        Args:
            known: the caller's own children, which are not reaped.
        """
        with contextlib.suppress(ChildProcessError):
            while ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                if ended.si_pid in known or ended.si_pid in self._foreign:
                    return
                _reap(ended.si_pid)


def _reap(pid: int) -> None:
    with contextlib.suppress(ChildProcessError):
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG)
