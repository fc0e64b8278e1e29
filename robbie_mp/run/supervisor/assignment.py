"""Both ends of the socket by which a spare interpreter learns which child to become: its standard input.

Before that it may be asked to rehearse: to import a module's class, and say what is wrong with it.

This file imports nothing else of Robbie-MP, so a process need not load the framework to act as a spare.
"""

import json
import os
import socket
from collections.abc import Callable

READY = b"ready\n"


def assign(connection: socket.socket, name: str, incarnation: int) -> None:
    """Tell a ready spare which child to become.

    Raises:
        OSError: the spare has died.
    """
    connection.send(json.dumps([name, incarnation]).encode() + b"\n")


def ask_to_rehearse(connection: socket.socket, name: str) -> None:
    """Ask a ready spare to rehearse a module; it answers with one line of JSON.

    Raises:
        OSError: the spare has died.
    """
    connection.send(json.dumps([name]).encode() + b"\n")


def wait_for_assignment(rehearse: Callable[[str], object] = lambda _name: None) -> tuple[str, int] | None:
    """In a spare: report `ready`, then wait; return the child's name and incarnation, None if not needed.

    Standard input is empty afterwards.

    Args:
        rehearse: called with the name of each module that is to be rehearsed; returns the answer.
    """
    with socket.socket(fileno=os.dup(0)) as connection:
        connection.sendall(READY)
        lines = connection.makefile("rb")
        while (line := lines.readline()) and len(asked := json.loads(line)) == 1:
            connection.sendall(json.dumps(rehearse(*asked), default=str).encode() + b"\n")
    nowhere = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nowhere, 0)
    os.close(nowhere)
    if not line:
        return None
    name, incarnation = asked
    return name, incarnation
