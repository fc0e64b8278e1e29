"""A serial or TCP port, opened by its URL."""

import errno
import os
import select
import socket
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import serial

from robbie_mp.base.device_links import DeviceLink, links, monotonic, sleep

# A host that does not answer at all is given up after this time.
CONNECT_TIMEOUT_S = 1.0
WRITE_TIMEOUT_S = 0.5
READ_BYTES = 65_536


REMEDIES = {
    errno.ENOENT: "; `robbie devices` lists the ports that are there",
    errno.EACCES: "; add the user to the group that may use it: sudo usermod -aG dialout $USER",
}


class PortError(OSError):
    """The port cannot be opened, or it broke."""


def _reason(error: Exception) -> str:
    """Say once why a port cannot be opened, and what to do: pyserial says it twice."""
    code = getattr(error, "errno", None)
    return f"{os.strerror(code)}{REMEDIES[code]}" if code in REMEDIES else str(error)


class Port:
    """An open port.

    Args:
        url: "/dev/ttyUSB0", or a stable name from a udev rule; "socket://HOST:PORT" for TCP;
            "rfc2217://HOST:PORT" for a serial port of a terminal server; any other URL that pyserial knows.
        bit_rate: bit/s of a serial line, 8 data bits, no parity, 1 stop bit.

    Raises:
        PortError: the port cannot be opened.
    """

    def __init__(self, url: str, bit_rate: int = 115_200) -> None:
        self.url = url
        try:
            self._link = links().open(url, lambda: _opened(url, bit_rate))
        except (OSError, ValueError) as error:
            raise PortError(f"cannot open the port {url}: {_reason(error)}") from None

    def read(self, wait_s: float) -> bytes:
        """Return what has arrived; wait for it at most `wait_s`. Empty: nothing came.

        Raises:
            PortError: the port broke, for example because it was pulled out.
        """
        try:
            return self._link.read(max(0.0, wait_s))
        except (OSError, TypeError) as error:  # pyserial: TypeError if it was closed meanwhile
            raise PortError(f"the port {self.url} broke: {error}") from error

    def pause(self, wait_s: float) -> None:
        """Let bytes gather for this time."""
        sleep(wait_s)

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            PortError: the port broke, or it took the bytes too slowly.
        """
        try:
            self._link.write(data)
        except OSError as error:
            raise PortError(f"the port {self.url} broke: {error}") from error

    def set_bit_rate(self, bit_rate: int) -> None:
        """Change the bit rate of a serial line; a TCP port has none.

        Raises:
            PortError: the port does not know this rate.
        """
        try:
            self._link.set_bit_rate(bit_rate)
        except (OSError, ValueError) as error:
            raise PortError(f"the port {self.url} refuses {bit_rate} bit/s: {error}") from error

    @property
    def descriptor(self) -> int | None:
        """Return the file descriptor of the open port; None: it has none, as `rfc2217://`."""
        return self._link.descriptor

    def drain(self, quiet_s: float, limit_s: float) -> None:
        """Read and forget what still arrives, until nothing came for `quiet_s`, or for `limit_s` at most.

        Raises:
            PortError: the port broke.
        """
        try:
            self._link.drain(quiet_s, limit_s)
        except (OSError, TypeError) as error:
            raise PortError(f"the port {self.url} broke: {error}") from error

    def close(self) -> None:
        """Close the port. A closed port may be closed again."""
        self._link.close()

    def set_motor_line(self, is_high: bool) -> None:
        """Set the DTR line of a serial port: some devices switch their motor by it.

        Ports that have no such line, such as pseudo-terminals and some USB devices, are left alone.
        """
        try:
            self._link.set_motor_line(is_high)
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):
                return
            raise PortError(f"the port {self.url} broke: {error}") from error


def holder_of(path: str) -> str:
    """Return which process has locked a file with flock(2), from proc_locks(5)."""
    status = os.stat(path)
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    for line in Path("/proc/locks").read_text().splitlines():
        fields = line.split()
        if fields[1] == "FLOCK" and fields[5] == place:
            with suppress(OSError):
                return f"process {fields[4]} ({Path(f'/proc/{fields[4]}/comm').read_text().strip()})"
    return "another process"


def _opened(url: str, bit_rate: int) -> DeviceLink:
    return _Tcp(url) if url.startswith("socket://") else _Serial(url, bit_rate)


class _Drained(ABC):
    """What all links have in common."""

    @abstractmethod
    def read(self, wait_s: float) -> bytes:
        """See `DeviceLink`."""

    def drain(self, quiet_s: float, limit_s: float) -> None:
        """See `DeviceLink`."""
        end_s = monotonic() + limit_s
        while monotonic() < end_s and self.read(quiet_s):
            pass


class _Serial(_Drained):
    """A port of pyserial's."""

    def __init__(self, url: str, bit_rate: int) -> None:
        options: dict[str, Any] = {} if "://" in url else {"exclusive": True}
        try:
            self._port = serial.serial_for_url(
                url, bit_rate, timeout=0, write_timeout=WRITE_TIMEOUT_S, **options
            )
        except OSError as error:
            if error.errno == errno.EWOULDBLOCK:
                raise BlockingIOError(f"{holder_of(url)} uses it") from None
            raise
        self.descriptor: int | None = getattr(self._port, "fd", None)
        # Other URLs of pyserial's do more than read, as `spy://`.
        self._is_plain = "://" not in url

    def read(self, wait_s: float) -> bytes:
        if self.descriptor is None:
            # A port without a descriptor, such as rfc2217, has a thread that reads.
            self._port.timeout = wait_s
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else b""
        if not select.select([self.descriptor], [], [], wait_s)[0]:
            return b""
        if not self._is_plain:
            spied: bytes = self._port.read(READ_BYTES)
            return spied
        # pyserial would wait once more by itself, which takes longer than all else here.
        try:
            data = os.read(self.descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("the device was pulled out")
        return data

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def set_bit_rate(self, bit_rate: int) -> None:
        self._port.baudrate = bit_rate

    def set_motor_line(self, is_high: bool) -> None:
        self._port.dtr = is_high

    def close(self) -> None:
        self.descriptor = None
        self._port.close()


class _Tcp(_Drained):
    """A TCP connection of our own: pyserial's would block for up to 5 s while a host does not answer."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.hostname is None or parts.port is None:
            raise ValueError("a TCP port looks like socket://192.168.0.10:10940")
        self._socket = socket.create_connection((parts.hostname, parts.port), CONNECT_TIMEOUT_S)
        if self._socket.getsockname() == self._socket.getpeername():
            # Without a listener, a port of this machine can be connected to itself.
            self._socket.close()
            raise ConnectionRefusedError("nobody listens")
        self._socket.settimeout(WRITE_TIMEOUT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, wait_s: float) -> bytes:
        if not select.select([self._socket], [], [], wait_s)[0]:
            return b""
        data = self._socket.recv(READ_BYTES)
        if not data:
            raise ConnectionResetError("the other end closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    @property
    def descriptor(self) -> int:
        return self._socket.fileno()

    def set_bit_rate(self, bit_rate: int) -> None:
        pass

    def set_motor_line(self, is_high: bool) -> None:
        pass

    def close(self) -> None:
        self._socket.close()
