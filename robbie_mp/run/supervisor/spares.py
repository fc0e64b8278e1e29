"""Interpreters started in advance, so that a restarted child need not wait for a new one.

Starting Python and importing numpy and Robbie-MP takes a few hundred ms: most of the time of a restart. A
spare has done this already and waits on a socket, its standard input, for the child to run
(`robbie_mp.run.supervisor.spare`). Spares are started like any child: each is a child of the supervisor in
a new session. No process is forked from one that has threads.
"""

import os
import select
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from robbie_mp.run.supervisor.assignment import READY, assign
from robbie_mp.run.supervisor.child_spec import ChildSpec
from robbie_mp.run.supervisor.event_loop import EventLoop
from robbie_mp.run.supervisor.leftovers import END_WAIT_S, kill_child_leftovers, marker
from robbie_mp.run.supervisor.output import ChildOutput
from robbie_mp.run.supervisor.process import ChildProcess
from robbie_mp.run.supervisor.streams import OutputStream
from robbie_mp.run.trace.kinds import Kind

MARKED_AS = "~spare"
"""The name in the marker of spares; no child can have it."""
CALM_S = 0.5
"""Starting a spare takes as much processor time as a cold start, so none is started while children start."""
MAX_FAILURES = 3


@dataclass(frozen=True)
class SpareCommand:
    """The command that starts spares."""

    count: int
    argv: tuple[str, ...]
    environment: Mapping[str, str]


class Spare:
    """One interpreter that waits for an assignment, or is still importing."""

    def __init__(self, process: ChildProcess, connection: socket.socket):
        self.process = process
        self.connection = connection
        self.is_ready = False


class SparePool:
    """Starts the processes of children: from a spare if one is ready, otherwise cold."""

    def __init__(
        self,
        command: SpareCommand | None,
        run_id: str,
        loop: EventLoop,
        output: ChildOutput,
        clock: Callable[[], float],
    ):
        """Prepare; no spare is started yet.

        Args:
            command: starts spares; None: every child starts cold.
            run_id: marks the processes of this run.
            loop: watches the spares.
            output: receives what a spare printed if it died before it was used.
            clock: monotonic time in s.
        """
        self._command = command
        self._run_id = run_id
        self._loop = loop
        self._output = output
        self._clock = clock
        self._spares: list[Spare] = []
        self._started = 0
        self._failures = 0
        self._calm_since_s: float | None = None

    @property
    def pids(self) -> set[int]:
        """Pids of the spares."""
        return {spare.process.pid for spare in self._spares}

    def start(self, spec: ChildSpec, incarnation: int) -> ChildProcess:
        """Start the process of a child.

        Raises:
            OSError: its command cannot be executed.
        """
        if spec.may_be_warm and incarnation > 1 and (process := self._take(spec.name, incarnation)):
            return process
        child_marker = marker(self._run_id, spec.name, incarnation)
        return ChildProcess.start(spec.argv, spec.environment, child_marker, spec.folder)

    def replenish(self, *, is_calm: bool) -> None:
        """Start a spare if one is missing and nothing has started or stopped for `CALM_S`."""
        now_s = self._clock()
        if not is_calm:
            self._calm_since_s = None
        elif self._calm_since_s is None:
            self._calm_since_s = now_s
        elif now_s - self._calm_since_s >= CALM_S and self._command and self._is_one_missing(self._command):
            self._calm_since_s = None  # one at a time
            self._start_spare(self._command)

    def close(self) -> None:
        """Kill and reap all spares."""
        for spare in list(self._spares):
            spare.process.kill()
            select.select([spare.process.pidfd], [], [], END_WAIT_S)
            self._remove(spare)
            self._discard(spare)

    def _is_one_missing(self, command: SpareCommand) -> bool:
        return self._failures < MAX_FAILURES and len(self._spares) < command.count

    def _start_spare(self, command: SpareCommand) -> None:
        self._started += 1
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        child_marker = marker(self._run_id, MARKED_AS, self._started)
        try:
            process = ChildProcess.start(
                command.argv, command.environment, child_marker, stdin=theirs.fileno()
            )
        except OSError as error:
            ours.close()
            self._fail(f"a spare interpreter cannot be started: {error}")
            return
        finally:
            theirs.close()
        spare = Spare(process, ours)
        self._spares.append(spare)
        self._loop.watch(ours.fileno(), lambda: self._on_readable(spare))
        self._loop.watch(process.pidfd, lambda: self._on_exit(spare))

    def _take(self, name: str, incarnation: int) -> ChildProcess | None:
        """Turn a ready spare into a child; return None if there is no spare."""
        for spare in [spare for spare in self._spares if spare.is_ready]:
            try:
                assign(spare.connection, name, incarnation)
            except OSError:
                continue  # it has died; the event loop will report it
            self._remove(spare)
            self._output.say(Kind.SYSTEM, f"spare interpreter {spare.process.pid} becomes {name}")
            return spare.process
        return None

    def _on_readable(self, spare: Spare) -> None:
        try:
            received = spare.connection.recv(len(READY))
        except OSError:
            received = b""
        spare.is_ready = received == READY
        if spare.is_ready:
            self._failures = 0
            self._output.say(Kind.SYSTEM, f"spare interpreter {spare.process.pid} is ready")
        else:  # it closed its input, so it cannot be assigned
            spare.process.kill()
            self._disconnect(spare)

    def _on_exit(self, spare: Spare) -> None:
        status = spare.process.exit_status()
        if status is None:
            return
        self._remove(spare)
        self._discard(spare)
        self._fail(f"a spare interpreter has ended: {status.reason}")

    def _remove(self, spare: Spare) -> None:
        """Remove a spare from the pool without ending it."""
        self._spares.remove(spare)
        self._loop.unwatch(spare.process.pidfd)
        self._disconnect(spare)

    def _disconnect(self, spare: Spare) -> None:
        if spare.connection.fileno() != -1:
            self._loop.unwatch(spare.connection.fileno())
            spare.connection.close()

    def _discard(self, spare: Spare) -> None:
        """Read what a dead spare printed, and reap it."""
        known = self.pids | {spare.process.pid}
        for pidfd in kill_child_leftovers(spare.process.pid, spare.process.marker, known).values():
            os.close(pidfd)  # it maps none of the run's memory, so its end need not be awaited
        for fd, name in ((spare.process.stdout, "stdout"), (spare.process.stderr, "stderr")):
            OutputStream(fd, name, self._output, self._loop).finish()
        os.close(spare.process.log_channel)
        spare.process.reap()

    def _fail(self, text: str) -> None:
        self._failures += 1
        if self._failures == MAX_FAILURES:
            text += "; no more spares are started, so restarts take longer"
        self._output.say(Kind.WARNING, text)
