"""Sends a command to a running supervisor."""

import json
import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robbie_mp.errors import RobbieError
from robbie_mp.supervisor.control import MAX_LINE_BYTES, socket_address


class ControlRefused(RobbieError, RuntimeError):
    """The supervisor did not do as it was told; the text is its own.

    Example scenarios:
      - no module has the name
      - the module was FAILED again before it was RUNNING
    """


class RunNotControlled(RobbieError, ConnectionError):
    """Nobody answers at the run's socket.

    Example scenarios:
      - the run is just starting, or has just ended
    """


def control(folder: Path, command: str, module: str | None = None, **more: object) -> str:
    """Send a command and wait until it is done.

    Args:
        folder: the run's folder.
        command: "stop", "start", "restart" or "record".
        module: whom it concerns; None: the whole run.
        more: what else belongs to the command.

    Returns:
        What the supervisor says; '' if the run has ended.

    Raises:
        ControlRefused: it says that this cannot be done.
        RunNotControlled: nobody answers.
    """
    request = {"command": command} | ({"module": module} if module is not None else {}) | more
    connection, answer = converse(folder, request)
    connection.close()
    if "error" in answer:
        raise ControlRefused(answer["error"])
    if module is not None and not answer:
        raise ControlRefused(f"the run ended before {module} was {command}ed")
    return str(answer.get("done", ""))


def converse(folder: Path, request: Mapping[str, object]) -> tuple[socket.socket, dict[str, Any]]:
    """Send a request; return the connection, still open, and the answer, empty if it was closed without one.

    Raises:
        RunNotControlled: nobody answers.
    """
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        folder_fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            connection.connect(socket_address(folder_fd))
        finally:
            os.close(folder_fd)
        connection.sendall(json.dumps(request).encode() + b"\n")
        line = b""
        while not line.endswith(b"\n") and (more := connection.recv(MAX_LINE_BYTES)):
            line += more
        return connection, json.loads(line or b"{}")
    except OSError as error:
        connection.close()
        raise RunNotControlled(
            f"run {folder.name} takes no commands: {error.strerror}; see `robbie list`"
        ) from error
