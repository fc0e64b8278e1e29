"""The carrier of an emulated device's bytes: a pseudo-terminal, or a TCP port."""

import fcntl
import os
import socket
import struct
import tty
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path

# asm-generic/ioctls.h and asm-generic/termbits.h: struct termios2 ends in the rates of input and output.
TCGETS2 = 0x802C542A
TERMIOS2_BYTES = 44
READ_BYTES = 4096


class Carrier(ABC):
    """A line that can be plugged in and pulled out. All operations return at once."""

    url: str
    """Where the host finds it, as pyserial names ports."""

    @abstractmethod
    def plug_in(self) -> None:
        """Let a host find the line, at the same `url` as before."""

    @abstractmethod
    def unplug(self) -> None:
        """Take the line away; the host's reads and writes fail."""

    @abstractmethod
    def readable(self) -> list[int]:
        """Return the descriptors to wait on."""

    @abstractmethod
    def read(self) -> bytes:
        """Return what the host has sent; empty if nothing."""

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Return how many of the bytes fitted."""

    def host_bit_rate(self) -> int | None:
        """Return the bit rate that the host has set, or None if the line has none."""
        return None

    def was_opened(self) -> bool:
        """Return True once after each time that a host can first be heard."""
        return False


class PseudoTerminal(Carrier):
    """A serial line: a pseudo-terminal that the host finds behind a link.

    Args:
        link: path of the link, like the stable names that udev rules give; it must not exist.
    """

    def __init__(self, link: Path) -> None:
        self.link, self.url = link, str(link)
        self._master = self._slave = -1
        self._is_new = False

    def plug_in(self) -> None:
        """Open a pseudo-terminal and make the link to it."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.symlink_to(os.ttyname(self._slave))
        self._is_new = True

    def unplug(self) -> None:
        """Remove the link and hang up."""
        self.link.unlink(missing_ok=True)
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1

    def readable(self) -> list[int]:
        """Return the terminal's master side."""
        return [self._master] if self._master >= 0 else []

    def read(self) -> bytes:
        """Return what the host has written."""
        with suppress(OSError):
            return os.read(self._master, READ_BYTES)
        return b""

    def write(self, data: bytes) -> int:
        """Write as much as the terminal's buffer takes."""
        with suppress(OSError):
            return os.write(self._master, data)
        return 0

    def host_bit_rate(self) -> int | None:
        """Return the rate that the host has set on its side of the terminal."""
        if self._slave < 0:
            return None
        termios2 = fcntl.ioctl(self._slave, TCGETS2, bytes(TERMIOS2_BYTES))
        rate: int = struct.unpack_from("I", termios2, TERMIOS2_BYTES - 4)[0]
        return rate

    def was_opened(self) -> bool:
        """Return True once after the terminal was plugged in: it keeps bytes until a host opens it."""
        is_new, self._is_new = self._is_new, False
        return is_new


class TcpPort(Carrier):
    """A TCP server on the loopback address for one host; a new connection replaces the old one.

    Args:
        port: its number; 0 chooses a free one, which stays the same ever after.
    """

    def __init__(self, port: int = 0) -> None:
        self._port = port
        self._server: socket.socket | None = None
        self._host: socket.socket | None = None
        self._is_new = False

    def plug_in(self) -> None:
        """Listen."""
        self._server = socket.create_server(("127.0.0.1", self._port))
        self._server.setblocking(False)
        self._port = self._server.getsockname()[1]
        self.url = f"socket://127.0.0.1:{self._port}"

    def unplug(self) -> None:
        """Reset the connection, and listen no more."""
        self._drop()
        if self._server is not None:
            with suppress(OSError):
                # Closing alone would leave it listening while another thread waits on it.
                self._server.shutdown(socket.SHUT_RDWR)
            self._server.close()
        self._server = None

    def readable(self) -> list[int]:
        """Return the listening socket and that of the host."""
        return [one.fileno() for one in (self._server, self._host) if one is not None]

    def read(self) -> bytes:
        """Accept a host that waits, and return what the host has sent."""
        if self._server is not None:
            with suppress(OSError):
                accepted, _ = self._server.accept()
                self._drop()
                accepted.setblocking(False)
                accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._host, self._is_new = accepted, True
        if self._host is None:
            return b""
        try:
            data = self._host.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> int:
        """Send as much as fits; without a host all of it is lost."""
        if self._host is None:
            return len(data)
        try:
            return self._host.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop()
            return len(data)

    def was_opened(self) -> bool:
        """Return True once after each connection."""
        is_new, self._is_new = self._is_new, False
        return is_new

    def _drop(self) -> None:
        if self._host is not None:
            # A reset rather than an orderly end: the address is free at once, and the host sees a fault.
            self._host.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._host.close()
        self._host = None
