"""Commands to a running supervisor: the protocol of its control socket, and the client.

The socket is `control` in the run's folder. Only a process that may enter this folder (mode 0700) can
connect. A client sends one request, a line of JSON such as `{"command": "restart", "module": "laser"}`. The
supervisor replies with one line as soon as the command is done: `{"done": TEXT}` or `{"error": TEXT}`.

After `{"command": "stop"}`, which stops the whole run, the supervisor closes the connection when the run is
over. After `{"command": "attach", "purpose": TEXT}` the connection stays open for as long as the tool is
attached; see `robbie_mp.run.supervisor.attached_tools`. For `debug` and `breakpoint` see
`robbie_mp.run.debug_link`.
"""

import json
import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError

SOCKET_NAME = "control"
MAX_LINE_BYTES = 4096
"""Maximum size of a request."""


class BadRequest(RobbieError, ValueError):
    """A client sent something that is not a command."""


def socket_address(folder_fd: int) -> str:
    """Return the socket's address by a descriptor of its folder, whose path may be too long."""
    return f"/proc/self/fd/{folder_fd}/{SOCKET_NAME}"


def pack_line(content: Mapping[str, object]) -> bytes:
    """Return a request or a reply as it is sent."""
    return json.dumps(content).encode() + b"\n"


def unpack_request(line: bytes) -> object:
    """Return the JSON value in a request.

    Raises:
        BadRequest: the line is not JSON.
    """
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BadRequest(f"expected a JSON object; got {line!r:.100} ({error})") from None


class ControlRefused(RobbieError, RuntimeError):
    """The supervisor refused a command or could not carry it out; the text is the supervisor's.

    Example scenarios:
      - no module has the name
      - the module was FAILED again before it was RUNNING
    """


class RunNotControlled(RobbieError, ConnectionError):
    """No supervisor replies at the run's control socket.

    Example scenarios:
      - the run is just starting, or has just ended
    """


def control(folder: Path, command: str, module: str | None = None, **more: object) -> str:
    """Send a command and wait until it is done.

    Args:
        folder: the run's folder.
        command: "stop", "start", "restart" or "record".
        module: the module to command; None: the whole run.
        more: further fields of the command.

    Returns:
        The supervisor's reply; '' if the run has ended.

    Raises:
        ControlRefused: the supervisor refused the command or could not carry it out.
        RunNotControlled: no supervisor replies.
    """
    request = {"command": command} | ({"module": module} if module is not None else {}) | more
    connection, reply = converse(folder, request)
    connection.close()
    if "error" in reply:
        raise ControlRefused(reply["error"])
    if module is not None and not reply:
        raise ControlRefused(f"the run ended before {module} was {command}ed")
    return str(reply.get("done", ""))


def converse(folder: Path, request: Mapping[str, object]) -> tuple[socket.socket, dict[str, Any]]:
    """Send a request; return the open connection and the reply, empty if the run ended without replying.

    Raises:
        RunNotControlled: no supervisor replies.
    """
    connection = connect(folder)
    try:
        connection.sendall(pack_line(request))
        line = b""
        while not line.endswith(b"\n") and (more := connection.recv(MAX_LINE_BYTES)):
            line += more
        return connection, json.loads(line or b"{}")
    except OSError as error:
        connection.close()
        raise _not_controlled(folder, error) from error


def connect(folder: Path) -> socket.socket:
    """Connect to the control socket of a run, given the run's folder.

    Raises:
        RunNotControlled: no supervisor replies.
    """
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        folder_fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            connection.connect(socket_address(folder_fd))
        finally:
            os.close(folder_fd)
    except OSError as error:
        connection.close()
        raise _not_controlled(folder, error) from error
    return connection


def _not_controlled(folder: Path, error: OSError) -> RunNotControlled:
    return RunNotControlled(f"run {folder.name} takes no commands: {error.strerror}; see `robbie list`")
