"""Interpreters started ahead: a restarted child takes one instead of waiting for its own to start.

Starting Python and importing numpy and Robbie-MP takes a few hundred ms: most of what a restart costs.
A spare has done it and waits on a socket, its standard input, to be told whom to run
(`robbie_mp.supervisor.spare`). It is started by the ordinary way, so it is this process's own child from the
beginning, in a session of its own, and nothing is ever forked from a process that has threads.
"""

import os
import select
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from robbie_mp.supervisor.child_spec import ChildSpec
from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.leftovers import END_WAIT_S, kill_child_leftovers, marker
from robbie_mp.supervisor.output import ChildOutput
from robbie_mp.supervisor.process import ChildProcess
from robbie_mp.supervisor.spare import READY, assign
from robbie_mp.supervisor.streams import OutputStream
from robbie_mp.trace.kinds import Kind

MARKED_AS = "~spare"
"""No child can have this name."""
CALM_S = 0.5
"""A spare takes a processor for as long as a restart without one; so none is started while children start."""
MAX_FAILURES = 3


@dataclass(frozen=True)
class SpareCommand:
    """What spares are started by."""

    count: int
    argv: tuple[str, ...]
    environment: Mapping[str, str]


class Spare:
    """One interpreter that waits, or is about to."""

    def __init__(self, process: ChildProcess, connection: socket.socket):
        self.process = process
        self.connection = connection
        self.is_ready = False


class SparePool:
    """Starts the processes of children: from a spare if there is one, else anew.

    Attributes:
        pids: of the spares.
    """

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
            command: what spares are started by; None: there are none.
            run_id: marks the processes of this run.
            loop: watches the spares.
            output: gets what a spare printed that died before it was used.
            clock: a time in s that never goes back.
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
        """Processes of the spares."""
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
        """Start a spare if one is missing and all has been calm for a while; called every turn."""
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
        """Hand a spare over to a child."""
        for spare in [spare for spare in self._spares if spare.is_ready]:
            try:
                assign(spare.connection, name, incarnation)
            except OSError:
                continue  # it has died; the loop is about to notice
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
        else:  # it closed its input and is of no use
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
        """Let go of a spare without ending it."""
        self._spares.remove(spare)
        self._loop.unwatch(spare.process.pidfd)
        self._disconnect(spare)

    def _disconnect(self, spare: Spare) -> None:
        if spare.connection.fileno() != -1:
            self._loop.unwatch(spare.connection.fileno())
            spare.connection.close()

    def _discard(self, spare: Spare) -> None:
        """Take what a dead spare printed, and reap it."""
        known = self.pids | {spare.process.pid}
        for pidfd in kill_child_leftovers(spare.process.pid, spare.process.marker, known).values():
            os.close(pidfd)  # it holds nothing of the run's memory, so nobody waits for its end
        for fd, name in ((spare.process.stdout, "stdout"), (spare.process.stderr, "stderr")):
            OutputStream(fd, name, self._output, self._loop).finish()
        os.close(spare.process.log_channel)
        spare.process.reap()

    def _fail(self, text: str) -> None:
        self._failures += 1
        if self._failures == MAX_FAILURES:
            text += "; no further one is started, so restarts take longer"
        self._output.say(Kind.WARNING, text)
