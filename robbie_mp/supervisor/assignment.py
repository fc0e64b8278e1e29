"""How a spare interpreter is told whom to run: both ends of the socket that is its standard input."""

import json
import os
import socket

READY = b"ready\n"


def assign(connection: socket.socket, name: str, incarnation: int) -> None:
    """Tell a spare that is ready whom to run.

    Raises:
        OSError: it has died.
    """
    connection.send(json.dumps([name, incarnation]).encode() + b"\n")


def wait_for_assignment() -> tuple[str, int] | None:
    """Say in a spare that it is ready; return name and incarnation of the child, None if none is needed.

    Standard input is empty afterwards.
    """
    with socket.socket(fileno=os.dup(0)) as connection:
        connection.sendall(READY)
        line = connection.makefile("rb").readline()
    nowhere = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nowhere, 0)
    os.close(nowhere)
    if not line:
        return None
    name, incarnation = json.loads(line)
    return name, incarnation
