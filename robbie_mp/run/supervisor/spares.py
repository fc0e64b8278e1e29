"""Interpreters started in advance, so that a restarted child need not wait for a new one.

Starting Python and importing numpy and Robbie-MP takes a few hundred ms: most of the time of a restart. A
spare has done this already and waits on a socket, its standard input, for the child to run
(`robbie_mp.run.supervisor.spare`). Spares are started like any child: each is a child of the supervisor in
a new session. No process is forked from one that has threads.
"""

import json
import os
import select
import socket
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from robbie_mp.run.supervisor.assignment import READY, ask_to_rehearse, assign
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
REHEARSAL_S = 10.0
"""How long a module may take to be imported, as before a run."""
MAX_ANSWER_BYTES = 1 << 22
READ_BYTES = 1 << 16


@dataclass(frozen=True)
class SpareCommand:
    """The command that starts spares."""

    count: int
    argv: tuple[str, ...]
    environment: Mapping[str, str]


class Rehearsal:
    """The question whether a module could be started with its code of now.

    Args:
        name: the module.
        on_done: called with the answer of `robbie_mp.run.supervisor.spare.Stage.rehearse`; or with None, and
            why there is none.
        keeps_spare: whether the module can take the place of the spare that has rehearsed it.
    """

    def __init__(
        self, name: str, on_done: Callable[[dict[str, Any] | None, str], None], *, keeps_spare: bool = True
    ):
        self.name = name
        self.on_done = on_done
        self.keeps_spare = keeps_spare
        self.until_s = 0.0


class Spare:
    """One interpreter that waits for an assignment, is still importing, or rehearses.

    Attributes:
        rehearsal: what it does now; None: it waits.
        rehearsed: the module that it has imported, the only one that it may become; '': none.
    """

    def __init__(self, process: ChildProcess, connection: socket.socket):
        self.process = process
        self.connection = connection
        self.is_ready = False
        self.rehearsal: Rehearsal | None = None
        self.rehearsed = ""
        self.received = b""


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
        self._rehearsals: deque[Rehearsal] = deque()
        """Those that wait for a spare."""

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

    def rehearse(self, rehearsal: Rehearsal) -> None:
        """Have a spare import a module, to see whether its code is right, and to become it afterwards."""
        for spare in list(self._spares):
            if spare.rehearsed == rehearsal.name:  # with older code
                self._end(spare)
        self._rehearsals.append(rehearsal)

    def replenish(self, *, is_calm: bool) -> None:
        """Start a spare if one is missing and nothing has started or stopped for `CALM_S`.

        A rehearsal does not wait for that.
        """
        now_s = self._clock()
        self._end_late_rehearsals(now_s)
        while self._rehearsals and (plain := [spare for spare in self._spares if _is_plain(spare)]):
            self._begin(self._rehearsals.popleft(), plain[0])
        if self._rehearsals:
            if self._command is None or self._failures >= MAX_FAILURES:
                self._rehearsals.popleft().on_done(None, "no spare interpreter can be started to check it")
            elif all(spare.is_ready for spare in self._spares):
                self._start_spare(self._command)
        elif not is_calm:
            self._calm_since_s = None
        elif self._calm_since_s is None:
            self._calm_since_s = now_s
        elif now_s - self._calm_since_s >= CALM_S and self._command and self._is_one_missing(self._command):
            self._calm_since_s = None  # one at a time
            self._start_spare(self._command)

    def close(self) -> None:
        """Kill and reap all spares."""
        self._rehearsals.clear()
        for spare in list(self._spares):
            self._end(spare)

    def _end(self, spare: Spare) -> None:
        """Kill a spare and reap it."""
        spare.process.kill()
        select.select([spare.process.pidfd], [], [], END_WAIT_S)
        self._remove(spare)
        self._discard(spare)

    def _begin(self, rehearsal: Rehearsal, spare: Spare) -> None:
        try:
            ask_to_rehearse(spare.connection, rehearsal.name)
        except OSError:  # it has died, which the loop tells next
            spare.is_ready = False
            self._rehearsals.appendleft(rehearsal)
            return
        rehearsal.until_s = self._clock() + REHEARSAL_S
        spare.rehearsal = rehearsal

    def _end_late_rehearsals(self, now_s: float) -> None:
        for spare in list(self._spares):
            if spare.rehearsal is not None and now_s >= spare.rehearsal.until_s:
                rehearsal, spare.rehearsal = spare.rehearsal, None
                self._end(spare)
                rehearsal.on_done(None, f"its import did not finish within {REHEARSAL_S:g} s")

    def _on_answer(self, spare: Spare, rehearsal: Rehearsal) -> None:
        """Read the answer of a spare; one that cannot become the module has imported too much, and ends."""
        try:
            data = spare.connection.recv(READ_BYTES)
        except OSError:
            data = b""
        spare.received += data
        if data and b"\n" not in spare.received and len(spare.received) < MAX_ANSWER_BYTES:
            return
        if not data:
            self._disconnect(spare)
            return  # it has died, which the loop tells next
        answer, spare.received, spare.rehearsal = _unpacked(spare.received), b"", None
        if answer.get("stale"):
            self._end(spare)
            self._rehearsals.appendleft(rehearsal)
            return
        is_wrong = answer.get("failure") or answer.get("errors") or answer.get("flaws")
        if is_wrong or not rehearsal.keeps_spare:
            self._end(spare)
        else:
            spare.rehearsed = rehearsal.name
        rehearsal.on_done(answer, "")

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
        usable = [spare for spare in self._spares if _is_plain(spare) or spare.rehearsed == name]
        for spare in sorted(usable, key=lambda spare: not spare.rehearsed):
            try:
                assign(spare.connection, name, incarnation)
            except OSError:
                continue  # it has died; the event loop will report it
            self._remove(spare)
            self._output.say(Kind.SYSTEM, f"spare interpreter {spare.process.pid} becomes {name}")
            return spare.process
        return None

    def _on_readable(self, spare: Spare) -> None:
        if spare.rehearsal is not None:
            self._on_answer(spare, spare.rehearsal)
            return
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
        if spare.rehearsal is not None:
            spare.rehearsal.on_done(None, f"its import ended the process: {status.reason}")
            return
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


def _is_plain(spare: Spare) -> bool:
    """Whether a spare may still become any module."""
    return spare.is_ready and spare.rehearsal is None and not spare.rehearsed


def _unpacked(line: bytes) -> dict[str, Any]:
    """Return the answer of a rehearsal, in which the code of the robot has run."""
    try:
        answer = json.loads(line)
    except (ValueError, RecursionError):
        answer = None
    return answer if isinstance(answer, dict) else {"failure": "its import wrote into the spare's connection"}
