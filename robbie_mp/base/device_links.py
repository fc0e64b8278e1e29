"""What lies between drivers and their devices: a robot records what crosses it, a replay answers instead.

A driver opens its port with `links().open`, reads the clock with `monotonic`, and waits with `sleep`. The
code that runs the driver chooses its links with `using_links`; the default is the links of this machine.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class DeviceLink(Protocol):
    """An open serial line or connection. Methods raise an OSError if it breaks."""

    @property
    def descriptor(self) -> int | None:
        """The file descriptor; None: it has none."""

    def read(self, wait_s: float) -> bytes:
        """Return what has arrived; wait for it at most `wait_s`. Empty: nothing came."""

    def drain(self, quiet_s: float, limit_s: float) -> None:
        """Read and forget what still arrives, until nothing came for `quiet_s`, or for `limit_s` at most."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def set_bit_rate(self, bit_rate: int) -> None:
        """Change the bit rate of a serial line."""

    def set_motor_line(self, is_high: bool) -> None:
        """Set the DTR line of a serial port."""

    def close(self) -> None:
        """Close it."""


class Links(Protocol):
    """Opens links, and tells the time that belongs to what arrives on them."""

    def open(self, url: str, opened: Callable[[], DeviceLink]) -> DeviceLink:
        """Open a link.

        Args:
            url: its name.
            opened: opens it on this machine.
        """

    def monotonic(self) -> float:
        """Return the time of a clock that never leaps, s."""

    def sleep(self, wait_s: float) -> None:
        """Wait."""


class MachineLinks:
    """The links of this machine, and its time; see `Links`."""

    def open(self, _url: str, opened: Callable[[], DeviceLink]) -> DeviceLink:
        """See `Links`."""
        return opened()

    def monotonic(self) -> float:
        """See `Links`."""
        return time.monotonic()

    def sleep(self, wait_s: float) -> None:
        """See `Links`."""
        time.sleep(wait_s)


_MACHINE = MachineLinks()
_links: ContextVar[Links | None] = ContextVar("links", default=None)


def links() -> Links:
    """Return the links that this thread uses."""
    return _links.get() or _MACHINE


def monotonic() -> float:
    """Return the time of a clock that never leaps, s: the machine's, or that of a replay."""
    return links().monotonic()


def sleep(wait_s: float) -> None:
    """Wait; a replay does not."""
    links().sleep(wait_s)


@contextmanager
def using_links(chosen: Links) -> Iterator[None]:
    """Let drivers in this thread use these links."""
    before = _links.set(chosen)
    try:
        yield
    finally:
        _links.reset(before)
