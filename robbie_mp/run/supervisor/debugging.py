"""Brings modules that stand at a breakpoint together with the terminals of `robbie attach`.

A module that stands is held: it does not count as hung, nor as late with its start. It stands until its user
lets it go on, the user's terminal is gone, it is to stop, or nobody is attached for `WAIT_S`. When nobody is
attached any more, or was in that time, the breakpoints of that process are passed until somebody is. So one
that was forgotten does not end a mission.
"""

import contextlib
import json
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from robbie_mp.run.control import BadRequest
from robbie_mp.run.supervisor.attached_tools import peer_pid
from robbie_mp.run.supervisor.child_spec import ChildKind
from robbie_mp.run.supervisor.supervised_child import SupervisedChild
from robbie_mp.run.supervisor.tree import CannotControl, Tree
from robbie_mp.run.trace.kinds import Kind

WAIT_S = 60.0
"""How long a module waits at a breakpoint if nobody is attached."""


@dataclass
class _Standing:
    """A module at a breakpoint."""

    child: SupervisedChild
    incarnation: int
    connection: socket.socket
    where: str
    until_s: float
    has_terminal: bool = False


@dataclass
class _Attached:
    """A terminal."""

    child: SupervisedChild
    connection: socket.socket
    pid: int
    told: str
    """What it was told last of the module."""


class Debugging:
    """Holds modules at breakpoints, and gives them the terminals of commands.

    Args:
        tree: the children; its event loop watches the connections.
        clock: monotonic time in s.
    """

    def __init__(self, tree: Tree, clock: Callable[[], float] = time.monotonic):
        self._tree = tree
        self._clock = clock
        self._standing: dict[str, _Standing] = {}
        self._attached: dict[str, _Attached] = {}
        self._deserted: dict[str, int] = {}
        """Modules, with their incarnation, whose breakpoints are passed until somebody is attached."""

    def attach(self, connection: socket.socket, name: str) -> None:
        """Attach a terminal to a module; the connection then belongs to this object.

        Args:
            connection: non-blocking and not watched by any loop.
            name: the module.

        Raises:
            NoSuchChild: no module has that name. The caller keeps the connection.
            CannotControl: it is the core, or another terminal is attached. The caller keeps the connection.
        """
        child = self._tree.child(name)
        if child.spec.kind is ChildKind.CORE:
            raise CannotControl("the core has no breakpoints; attach a module")
        if other := self._attached.get(name):
            raise CannotControl(f"{name} has a terminal already: that of process {other.pid}")
        told = _state(child)
        terminal = _Attached(child, connection, peer_pid(connection), told)
        self._attached[name] = terminal
        self._deserted.pop(name, None)
        self._tree.watch(connection.fileno(), lambda: self._detach(terminal))
        self._tell(terminal, {"done": f"attached: {told}"})
        self._connect(name)

    def stand(self, connection: socket.socket, where: str) -> None:
        """Hold the module that asks for a terminal; the connection then belongs to this object.

        Raises:
            BadRequest: no module asks. The caller keeps the connection.
        """
        pid = peer_pid(connection)
        child = next((child for child in self._tree.children if child.pid == pid), None)
        if child is None or child.spec.kind is ChildKind.CORE:
            raise BadRequest("expected a module of this run to stand at the breakpoint")
        name = child.spec.name
        if name in self._standing:  # it went on, and stands again before its last connection was seen to end
            self._release(self._standing[name])
        if child.is_stopping or self._deserted.get(name) == child.incarnation:
            connection.close()
            return
        standing = _Standing(child, child.incarnation, connection, where, self._clock() + WAIT_S)
        self._standing[name] = standing
        child.is_debugged = True
        self._tree.watch(connection.fileno(), lambda: self._release(standing))
        if name not in self._attached:
            child.output.say(
                Kind.WARNING,
                f"stands at a breakpoint, {where}: `robbie attach {name}` opens the debugger; goes on after "
                f"{WAIT_S:g} s if nobody does",
            )
        self._connect(name)

    def turn(self) -> None:
        """Let modules go on that are to stop or that nobody attends; called in every turn of the loop."""
        for standing in list(self._standing.values()):
            if standing.child.is_stopping or standing.child.incarnation != standing.incarnation:
                self._release(standing)
            elif not standing.has_terminal and self._clock() >= standing.until_s:
                self._desert(standing)
        for terminal in list(self._attached.values()):
            if (state := _state(terminal.child)) != terminal.told:
                terminal.told = state
                self._tell(terminal, {"note": state})

    def close(self) -> None:
        """Close all connections; the run is over."""
        for standing in self._standing.values():
            standing.connection.close()
        for terminal in self._attached.values():
            terminal.connection.close()
        self._standing.clear()
        self._attached.clear()

    def _connect(self, name: str) -> None:
        """Give a module that stands its terminal, if there is one."""
        standing, terminal = self._standing.get(name), self._attached.get(name)
        if standing is None or terminal is None or standing.has_terminal:
            return
        standing.has_terminal = True
        ours, theirs = socket.socketpair()
        with ours, theirs:
            if self._tell(terminal, {"stopped": standing.where}, theirs):
                _send(standing.connection, {"terminal": True}, ours)  # if that fails, it has ended

    def _desert(self, standing: _Standing) -> None:
        self._release(standing)
        self._pass(standing.child, f"goes on: nobody was attached for {WAIT_S:g} s")

    def _pass(self, child: SupervisedChild, why: str) -> None:
        self._deserted[child.spec.name] = child.incarnation
        advice = f"its breakpoints are passed until you call `robbie attach {child.spec.name}`"
        child.output.say(Kind.WARNING, f"{why}; {advice}")

    def _release(self, standing: _Standing) -> None:
        """Let a module go on: it sees the end of its connection."""
        del self._standing[standing.child.spec.name]
        if standing.child.incarnation == standing.incarnation:
            standing.child.is_debugged = False
        self._tree.unwatch(standing.connection.fileno())
        standing.connection.close()

    def _detach(self, terminal: _Attached) -> None:
        """Forget a terminal that has gone, and let its module go on."""
        name = terminal.child.spec.name
        del self._attached[name]
        self._tree.unwatch(terminal.connection.fileno())
        terminal.connection.close()
        if standing := self._standing.get(name):
            self._release(standing)
        self._pass(terminal.child, "the terminal of `robbie attach` has gone")

    def _tell(
        self, terminal: _Attached, line: dict[str, object], carried: socket.socket | None = None
    ) -> bool:
        """Send a terminal a line; detach it if it has gone or does not read."""
        is_sent = _send(terminal.connection, line, carried)
        if not is_sent:
            self._detach(terminal)
        return is_sent


def _state(child: SupervisedChild) -> str:
    reason = f" ({child.reason})" if child.reason else ""
    return f"{child.spec.name} is {child.state}{reason}" if child.state else f"{child.spec.name} waits"


def _send(connection: socket.socket, line: dict[str, object], carried: socket.socket | None) -> bool:
    """Send a line at once, with a descriptor; return False if that is not possible."""
    fds = [carried.fileno()] if carried else []
    with contextlib.suppress(OSError):
        data = json.dumps(line).encode() + b"\n"
        return socket.send_fds(connection, [data], fds) == len(data)
    return False
