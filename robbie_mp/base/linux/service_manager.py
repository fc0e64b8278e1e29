"""Notices to the service manager, such as systemd, that this process runs and does not hang: sd_notify(3)."""

import contextlib
import os
import socket
import time
from collections.abc import Callable, Mapping

from typing_extensions import Self

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Environment variables that are meant for this process and not for its children."""
NOTICES_IN_TIME = 4
"""How often the watchdog is told in the time after which it would end this process."""


class ServiceManager:
    """The service manager that started this process, if one did.

    Notices are datagrams. One that the service manager has no room for is dropped, and the next one follows.

    Args:
        address: of its socket; '': nobody wants notices.
        watchdog_s: time without a notice after which it takes this process for dead; None: it does not watch.
        clock: monotonic time in s.
    """

    def __init__(
        self, address: str, watchdog_s: float | None = None, clock: Callable[[], float] = time.monotonic
    ):
        self._period_s = None if watchdog_s is None else watchdog_s / NOTICES_IN_TIME
        self._clock = clock
        self._next_s = clock()
        self._told: set[str] = set()
        self._status = ""
        self._socket: socket.socket | None = None
        self._address = address.replace("@", "\0", 1) if address.startswith("@") else address
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    @classmethod
    def of_environment(cls, environment: Mapping[str, str] = os.environ) -> Self:
        """Return the service manager that the environment names."""
        time_us = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watches = time_us.isdecimal() and int(time_us) > 0 and is_for_us
        return cls(environment.get("NOTIFY_SOCKET", ""), int(time_us) / 1e6 if watches else None)

    def turn(self, *, is_ready: bool, status: str = "", stop_reason: str = "") -> None:
        """Tell what is new, and that this process does not hang. Call this in each turn of a loop.

        Args:
            is_ready: whether the service has started.
            status: one line on how it is doing, for `systemctl status`; told when it has changed.
            stop_reason: why it stops; '' while it does not.
        """
        if self._socket is None:
            return
        if stop_reason:
            self._tell_once(f"STOPPING=1\nSTATUS=the run stops: {' '.join(stop_reason.split())}")
        elif is_ready:
            self._tell_once("READY=1")
            self._tell_status(status)
        now_s = self._clock()
        if self._period_s is not None and now_s >= self._next_s:
            self._next_s = now_s + self._period_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell_status(self, status: str) -> None:
        line = " ".join(status.split())
        if line != self._status and self._send(f"STATUS={line}"):
            self._status = line

    def _tell_once(self, text: str) -> None:
        if text not in self._told and self._send(text):
            self._told.add(text)

    def _send(self, text: str) -> bool:
        assert self._socket is not None
        with contextlib.suppress(OSError):  # it has no room, or is restarting
            self._socket.sendto(text.encode(), self._address)
            return True
        return False
