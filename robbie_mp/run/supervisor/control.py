"""The supervisor's end of the control socket; `robbie_mp.run.control` describes the protocol.

Nothing here blocks the supervisor. A client that sends too much, sends too slowly or does not read its reply
is disconnected.
"""

import contextlib
import errno
import os
import signal
import socket
import time
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import PRIVATE_FILE
from robbie_mp.run.control import MAX_LINE_BYTES, BadRequest, pack_line, socket_address, unpack_request
from robbie_mp.run.profile.preflight import what_failed
from robbie_mp.run.supervisor.attached_tools import AttachedTools
from robbie_mp.run.supervisor.child_spec import ChildKind
from robbie_mp.run.supervisor.debugging import Debugging
from robbie_mp.run.supervisor.output import STALLED_AFTER_S, SUPERVISOR
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.supervised_child import SupervisedChild
from robbie_mp.run.supervisor.swaps import Swaps
from robbie_mp.run.supervisor.tree import Tree
from robbie_mp.run.trace.kinds import RECORDED_FILE, Kind, recorded_as_json, write_recorded
from robbie_mp.run.variant import Variant


class TraceRecording:
    """Sets which kinds of trace entries are recorded of each child, and informs the children."""

    def __init__(self, run_folder: Path, tree: Tree):
        """Write the file that the children read. Call this before any child starts.

        Args:
            run_folder: the run's folder, which holds the file.
            tree: the children, each with the kinds recorded at first.
        """
        self._run_folder = run_folder
        self._tree = tree
        write_recorded(run_folder, self._recorded())  # before any child reads it

    def set(self, kinds: Collection[Kind], name: str | None, on_informed: Callable[[bool], None]) -> None:
        """Record these kinds from now on.

        Args:
            kinds: other kinds are not recorded.
            name: a module, the core, or "supervisor" for its remarks; None: all modules.
            on_informed: called when the children have been informed; with False if the disk refused the file.

        Raises:
            NoSuchChild: no child has that name.
        """
        if name == SUPERVISOR:
            self._tree.output.remarked_kinds = frozenset(kinds)
            self._inform([], on_informed)
            return
        modules = [child for child in self._tree.children if child.spec.kind is ChildKind.MODULE]
        changed = modules if name is None else [self._tree.child(name)]
        for child in changed:
            child.output.kinds = frozenset(kinds)
        self._inform(changed, on_informed)

    def _recorded(self) -> dict[str, Collection[Kind]]:
        recorded = {child.spec.name: child.output.kinds for child in self._tree.children}
        return {SUPERVISOR: self._tree.output.remarked_kinds, **recorded}

    def _inform(self, changed: Collection[SupervisedChild], on_informed: Callable[[bool], None]) -> None:
        def on_done(is_done: bool) -> None:
            for child in changed:
                child.send_signal(signal.SIGURG)
            on_informed(is_done)

        path = self._run_folder / RECORDED_FILE
        self._tree.output.disk.order(["replace", str(path)], recorded_as_json(self._recorded()), on_done)


MAX_CLIENTS = 8
OUT_OF_DESCRIPTORS = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
ACCEPT_RETRY_S = 0.2
"""How long no client is accepted after the process ran out of descriptors."""
LINE_TIMEOUT_S = 2.0
MAX_PURPOSE_LENGTH = 100

Answer = dict[str, str]
Progress = Callable[[], Answer | None]
"""Returns the reply as soon as it is known."""


class ControlServer:
    """Serves the control socket in the tree's event loop."""

    def __init__(
        self,
        folder: Path,
        tree: Tree,
        clock: Callable[[], float] = time.monotonic,
        tools: AttachedTools | None = None,
        debugging: Debugging | None = None,
    ):
        """Listen; clients are served once the tree runs.

        Args:
            folder: the run's folder.
            tree: the children to control.
            clock: monotonic time in s.
            tools: attaches tools; None: tools cannot attach.
            debugging: holds modules at breakpoints; None: they pass them.
        """
        self._tree = tree
        self._debugging = debugging
        self._tools = tools
        self._recording = TraceRecording(folder, tree)
        self._swaps = Swaps(tree, clock)
        self._clock = clock
        self._clients: list[_Client] = []
        self._accept_again_s: float | None = None
        """Until then no client is accepted, because no descriptor was left; None: clients are accepted."""
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        folder_fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        os.fchmod(self._listener.fileno(), PRIVATE_FILE)  # bind gives this mode to the name
        try:
            self._listener.bind(socket_address(folder_fd))
            self._listener.listen(MAX_CLIENTS)
        finally:
            os.close(folder_fd)
        tree.watch(self._listener.fileno(), self._on_connect)

    def turn(self) -> None:
        """Reply to clients whose command is done, disconnect late ones; called in every loop iteration."""
        self._swaps.turn()
        if self._accept_again_s is not None and self._clock() >= self._accept_again_s:
            self._accept_again_s = None
            self._tree.watch(self._listener.fileno(), self._on_connect)
        for client in list(self._clients):
            if client.progress is None:
                if self._clock() >= client.deadline_s:
                    self._answer(client, {"error": f"no command came within {LINE_TIMEOUT_S:g} s"})
            elif (answer := client.progress()) is not None:
                self._answer(client, answer)

    def close(self) -> None:
        """Close all connections. Call this when the tree no longer runs."""
        for client in self._clients:
            client.connection.close()
        self._listener.close()

    def _on_connect(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError as error:
            if error.errno in OUT_OF_DESCRIPTORS:  # the listener stays readable, so the loop would spin
                self._tree.unwatch(self._listener.fileno())
                self._accept_again_s = self._clock() + ACCEPT_RETRY_S
            return  # otherwise the client has gone
        connection.setblocking(False)
        client = _Client(connection, self._clock() + LINE_TIMEOUT_S)
        self._clients.append(client)
        self._tree.watch(connection.fileno(), lambda: self._on_readable(client))
        if len(self._clients) > MAX_CLIENTS:
            self._answer(client, {"error": f"{MAX_CLIENTS} other commands wait already; try again"})

    def _on_readable(self, client: "_Client") -> None:
        try:
            data = client.connection.recv(MAX_LINE_BYTES)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        client.received += data
        line, newline, rest = client.received.partition(b"\n")
        if client.progress is not None or rest or len(line) > MAX_LINE_BYTES:
            self._answer(client, {"error": f"expected one line of at most {MAX_LINE_BYTES} bytes"})
        elif newline:
            try:
                client.progress = self._begin(line, client)
            except (RobbieError, OSError) as error:
                self._answer(client, {"error": str(error)})

    def _begin(self, line: bytes, client: "_Client") -> Progress | None:
        """Carry out a request; return a function that reports when it is done."""
        request = unpack_request(line)
        if (take := self._taking(request)) is not None:
            self._hand_over(client, take)
            return None
        match request:
            case {"command": "stop" | "start" | "restart" as command, "module": str(name)}:
                return self._move(command, name)
            case {"command": "swap", "module": str(name), "variant": variant, "fresh": bool(is_fresh)}:
                return self._swaps.begin(name, Variant.of(variant), is_fresh=is_fresh).progress
            case {"command": "record", "kinds": [*kinds], **others} if not others.keys() - {"module"}:
                return self._record(kinds, others.get("module"))
            case {"command": "stop", **others} if not others:
                self._tree.stop("stopped by command")
                return lambda: None
            case request:
                expected = "stop, attach, record, debug, or stop, start, restart or swap of a module"
                raise BadRequest(f"expected {expected}; got {request!r:.100}")

    def _move(self, command: str, name: str) -> Progress:
        if command == "stop":
            return _stopped(self._tree.stop_child(name, "stopped by command"))
        if command == "start":
            return _restarted(self._tree.start_child(name, "started by command"))
        return _restarted(self._tree.restart_child(name, "restarted by command"))

    def _taking(self, request: object) -> Callable[[socket.socket], None] | None:
        """Return what takes over the connection of such a request; None: nothing does."""
        match request:
            case {"command": "attach", "purpose": str(purpose)} if self._tools:
                return partial(self._tools.attach, purpose=purpose[:MAX_PURPOSE_LENGTH])
            case {"command": "debug", "module": str(name)} if self._debugging:
                return partial(self._debugging.attach, name=name)
            case {"command": "breakpoint", "where": str(where)} if self._debugging:
                return partial(self._debugging.stand, where=where)
        return None

    def _hand_over(self, client: "_Client", take: Callable[[socket.socket], None]) -> None:
        self._tree.unwatch(client.connection.fileno())
        try:
            take(client.connection)
        except BaseException:
            self._tree.watch(client.connection.fileno(), lambda: self._on_readable(client))
            raise
        self._clients.remove(client)

    def _record(self, kinds: list[object], name: object) -> Progress:
        if not all(kind in list(Kind) for kind in kinds) or not isinstance(name, str | None):
            raise BadRequest(f"expected kinds of {', '.join(Kind)}; got {kinds!r:.100}")
        recorded = [kind for kind in Kind if kind in kinds]
        informed: list[bool] = []
        self._recording.set(recorded, name, informed.append)
        done = f"{name or 'every module'}: {', '.join(recorded) or 'nothing'} recorded from now on"

        def progress() -> Answer | None:
            if informed:
                return (
                    {"done": done}
                    if informed[0]
                    else {"error": f"{done}; but the disk refused the file that informs the modules"}
                )
            if self._tree.output.disk.stalled_s >= STALLED_AFTER_S:
                return {"done": f"{done}; the disk has stalled, so modules are informed when it recovers"}
            return None

        return progress

    def _answer(self, client: "_Client", answer: Answer) -> None:
        with contextlib.suppress(OSError):  # the client has gone, or does not read
            client.connection.send(pack_line(answer))
        self._drop(client)

    def _drop(self, client: "_Client") -> None:
        self._clients.remove(client)
        self._tree.unwatch(client.connection.fileno())
        client.connection.close()


class _Client:
    """One client's connection."""

    def __init__(self, connection: socket.socket, deadline_s: float):
        self.connection = connection
        self.deadline_s = deadline_s
        self.received = b""
        self.progress: Progress | None = None


def _stopped(child: SupervisedChild) -> Progress:
    def progress() -> Answer | None:
        if child.state is not None and child.state.is_final:
            return {"done": f"{child.spec.name} is {child.state} ({child.reason})"}
        return None

    return progress


def _restarted(child: SupervisedChild) -> Progress:
    before = child.incarnation

    def progress() -> Answer | None:
        if child.state is ChildState.RUNNING and child.incarnation > before:
            return {"done": f"{child.spec.name} is RUNNING, start {child.incarnation}"}
        has_ended = child.state is ChildState.BACKOFF and child.incarnation > before
        if has_ended or (child.state is not None and child.state.is_final):
            what = f"{child.spec.name} is {child.state}: {child.reason}"
            why = what_failed("\n".join(child.output.last_lines))
            outlook = "it is tried again" if has_ended else ""
            return {"error": "; ".join(filter(None, (what, why, outlook)))}
        return None

    return progress
