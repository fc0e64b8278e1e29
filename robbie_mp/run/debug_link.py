"""How a module at a breakpoint, the supervisor and `robbie attach` talk: one line of JSON after the other.

Module and command each ask the supervisor by the run's control socket (`robbie_mp.run.control`), and keep the
connection:

- `{"command": "breakpoint", "where": TEXT}` comes from a module that stands at a breakpoint. Its watchdog is
  held until the connection ends. The reply `{"terminal": true}` carries a descriptor, the terminal. When the
  supervisor closes the connection, the module goes on.
- `{"command": "debug", "module": NAME}` comes from `robbie attach`. The reply is `{"done": TEXT}`; then
  `{"note": TEXT}` tells what happens to the module, and `{"stopped": TEXT}` carries a terminal.

A terminal is one end of a socket pair. The module sends `{"text": TEXT}`, `{"ask": true}` when it waits for a
line, and `{"end": true}` when the user has left the debugger; the command sends `{"line": TEXT}`.
"""

import contextlib
import json
import os
import select
import socket
from typing import Any

TEXT_CHARACTERS = 8192
"""Longest text in one line; a longer one is sent in pieces."""
MAX_LINE_BYTES = 1 << 20
READ_BYTES = 1 << 16
CARRY = ("terminal", "stopped")
"""Lines with one of these carry a descriptor."""

Line = dict[str, Any]


class DebugLink:
    """One end of a connection.

    Args:
        connection: the socket, which this object owns; blocking.
    """

    def __init__(self, connection: socket.socket):
        self.connection = connection
        self._received = b""
        self._fds: list[int] = []

    def send(self, line: Line) -> None:
        """Send a line.

        Raises:
            OSError: the other end has gone.
        """
        self.connection.sendall(json.dumps(line).encode() + b"\n")

    def receive(self) -> Line | None:
        """Wait for a line; None: the other end has gone, or does not keep to the form."""
        while b"\n" not in self._received and len(self._received) < MAX_LINE_BYTES:
            try:
                data, fds, _flags, _address = socket.recv_fds(self.connection, READ_BYTES, 4)
            except OSError:
                return None
            self._fds += fds
            for fd in fds:
                os.set_inheritable(fd, False)
            if not data:
                return None
            self._received += data
        text, _, self._received = self._received.partition(b"\n")
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            return None
        return line if isinstance(line, dict) else None

    def carried(self) -> "DebugLink | None":
        """Return the terminal that the last line carried; None: it carried none."""
        return DebugLink(socket.socket(fileno=self._fds.pop(0))) if self._fds else None

    def has_news(self, timeout_s: float) -> bool:
        """Wait until a line has come, or the other end has gone; False: neither, in this time."""
        return b"\n" in self._received or bool(select.select([self.connection], [], [], timeout_s)[0])

    def close(self) -> None:
        """Close the connection, and terminals that nobody has taken."""
        self.connection.close()
        while self._fds:
            with contextlib.suppress(OSError):
                os.close(self._fds.pop())
