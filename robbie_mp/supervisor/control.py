"""The socket by which commands reach a running supervisor: `control` in the run's folder.

A client sends one line, a JSON object such as `{"command": "restart", "module": "laser"}`, and gets one
line back as soon as it is done: `{"done": TEXT}` or `{"error": TEXT}`. After `{"command": "stop"}`, which
stops the whole run, the connection is closed when the run is over. After `{"command": "attach", "purpose":
TEXT}` it stays open for as long as the tool is attached (see `attached_tools`). Only who may enter the run's
folder (mode 0700) can connect. Nothing here ever blocks the supervisor: a client that sends too much, too
slowly, or does not read what it is told is cut off.
"""

import contextlib
import errno
import json
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.linux.private_files import PRIVATE_FILE
from robbie_mp.supervisor.attached_tools import AttachedTools
from robbie_mp.supervisor.output import STALLED_AFTER_S
from robbie_mp.supervisor.recording import Recording
from robbie_mp.supervisor.states import ChildState
from robbie_mp.supervisor.supervised_child import SupervisedChild
from robbie_mp.supervisor.tree import Tree
from robbie_mp.trace.kinds import Kind

SOCKET_NAME = "control"
MAX_CLIENTS = 8
MAX_LINE_BYTES = 4096
NO_ROOM = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
DEAF_S = 0.2
LINE_TIMEOUT_S = 2.0
PURPOSE_LENGTH = 100

Answer = dict[str, str]
Progress = Callable[[], Answer | None]
"""Returns the answer when it is known."""


class BadRequest(RobbieError, ValueError):
    """A client sent something that is no command."""


def socket_address(folder_fd: int) -> str:
    """Return the socket's address: by its folder's descriptor, for the folder's path may be too long."""
    return f"/proc/self/fd/{folder_fd}/{SOCKET_NAME}"


class ControlServer:
    """Serves the socket in the tree's event loop."""

    def __init__(
        self,
        folder: Path,
        tree: Tree,
        clock: Callable[[], float] = time.monotonic,
        tools: AttachedTools | None = None,
    ):
        """Listen, from the tree's first turn on.

        Args:
            folder: the run's folder.
            tree: what is controlled.
            clock: a time in s that never goes back.
            tools: where tools attach; None: nowhere.
        """
        self._tree = tree
        self._tools = tools
        self._recording = Recording(folder, tree)
        self._clock = clock
        self._clients: list[_Client] = []
        self._deaf_until_s: float | None = None
        """Until then nobody is accepted, for there was no descriptor left."""
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        folder_fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        os.fchmod(self._listener.fileno(), PRIVATE_FILE)  # which the name gets from it
        try:
            self._listener.bind(socket_address(folder_fd))
            self._listener.listen(MAX_CLIENTS)
        finally:
            os.close(folder_fd)
        tree.watch(self._listener.fileno(), self._on_connect)

    def turn(self) -> None:
        """Answer whose wish has come true, cut off who is late; called every turn of the loop."""
        if self._deaf_until_s is not None and self._clock() >= self._deaf_until_s:
            self._deaf_until_s = None
            self._tree.watch(self._listener.fileno(), self._on_connect)
        for client in list(self._clients):
            if client.progress is None:
                if self._clock() >= client.late_s:
                    self._answer(client, {"error": f"no command came within {LINE_TIMEOUT_S:g} s"})
            elif (answer := client.progress()) is not None:
                self._answer(client, answer)

    def close(self) -> None:
        """Close all connections; the tree no longer runs."""
        for client in self._clients:
            client.connection.close()
        self._listener.close()

    def _on_connect(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError as error:
            if error.errno in NO_ROOM:  # it stays readable: the loop would come here again and again
                self._tree.unwatch(self._listener.fileno())
                self._deaf_until_s = self._clock() + DEAF_S
            return  # else it went away
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
        """Do as a request says, and return how to see when it is done."""
        match _parse(line):
            case {"command": "stop", "module": str(name)}:
                return _stopped(self._tree.stop_child(name, "stopped by command"))
            case {"command": "start", "module": str(name)}:
                return _restarted(self._tree.start_child(name, "started by command"))
            case {"command": "restart", "module": str(name)}:
                return _restarted(self._tree.restart_child(name, "restarted by command"))
            case {"command": "attach", "purpose": str(purpose)} if self._tools:
                self._hand_over(client, purpose[:PURPOSE_LENGTH], self._tools)
                return None
            case {"command": "record", "kinds": [*kinds], **others} if not others.keys() - {"module"}:
                return self._record(kinds, others.get("module"))
            case {"command": "stop", **others} if not others:
                self._tree.stop("stopped by command")
                return lambda: None
            case request:
                expected = "stop, attach, record, or stop, start or restart of a module"
                raise BadRequest(f"expected {expected}; got {request!r:.100}")

    def _hand_over(self, client: "_Client", purpose: str, tools: AttachedTools) -> None:
        self._tree.unwatch(client.connection.fileno())
        try:
            tools.attach(client.connection, purpose)
        except BaseException:
            self._tree.watch(client.connection.fileno(), lambda: self._on_readable(client))
            raise
        self._clients.remove(client)

    def _record(self, kinds: list[object], name: object) -> Progress:
        if not all(kind in list(Kind) for kind in kinds) or not isinstance(name, str | None):
            raise BadRequest(f"expected kinds of {', '.join(Kind)}; got {kinds!r:.100}")
        recorded = [kind for kind in Kind if kind in kinds]
        told: list[bool] = []
        self._recording.set(recorded, name, told.append)
        done = f"{name or 'every module'}: {', '.join(recorded) or 'nothing'} recorded from now on"

        def progress() -> Answer | None:
            if told:
                return {"done": done} if told[0] else {"error": f"{done}; the disk refused to tell modules"}
            if self._tree.output.disk.stalled_s >= STALLED_AFTER_S:
                return {"done": f"{done}; modules hear of it when the disk, which has stalled, goes on"}
            return None

        return progress

    def _answer(self, client: "_Client", answer: Answer) -> None:
        with contextlib.suppress(OSError):  # it does not wait for an answer, or does not read
            client.connection.send(json.dumps(answer).encode() + b"\n")
        self._drop(client)

    def _drop(self, client: "_Client") -> None:
        self._clients.remove(client)
        self._tree.unwatch(client.connection.fileno())
        client.connection.close()


class _Client:
    """One connection."""

    def __init__(self, connection: socket.socket, late_s: float):
        self.connection = connection
        self.late_s = late_s
        self.received = b""
        self.progress: Progress | None = None


def _parse(line: bytes) -> object:
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BadRequest(f"expected a JSON object; got {line!r:.100} ({error})") from None


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
        if child.state is not None and child.state.is_final:
            return {"error": f"{child.spec.name} is {child.state}: {child.reason}"}
        return None

    return progress
