"""Both ends of the socket by which a spare interpreter learns which child to become: its standard input.

This file imports nothing else of Robbie-MP, so a process need not load the framework to act as a spare.
"""

import json
import os
import socket

READY = b"ready\n"


def assign(connection: socket.socket, name: str, incarnation: int) -> None:
    """Tell a ready spare which child to become.

    Raises:
        OSError: the spare has died.
    """
    connection.send(json.dumps([name, incarnation]).encode() + b"\n")


def wait_for_assignment() -> tuple[str, int] | None:
    """In a spare: report `ready`, then wait; return the child's name and incarnation, None if not needed.

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
