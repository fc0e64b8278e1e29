"""A device whose library waits by itself: a thread opens it and reads it."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from threading import Condition, Thread
from typing import Generic, TypeVar

from robbie_robots.hw.connection.device import MAX_BACKOFF_S, MIN_BACKOFF_S, ConnectionState, Counters
from robbie_robots.hw.connection.errors import DeviceFault

# A call of the library that takes longer does not end any more. OpenCV waits 10 s for a camera.
MAX_CALL_S = 15.0
END_S = 2.0

T = TypeVar("T")


class DeviceStuck(DeviceFault):
    """The device's library does not return: only a new process helps."""


class BackgroundDevice(ABC, Generic[T]):
    """A device that reconnects by itself, with backoff, read by a thread of its own.

    It has the same face as `PluggableDevice` of `device.py`: call `poll` again and again. It counts as
    connected when its first value has come. If it breaks, or is silent for `silence_s`, it is closed and
    opened again, and values that nobody has taken are dropped.

    Args:
        name: what people call it, such as its path.
        silence_s: it counts as lost when nothing comes for this time.
        kept: values that wait for `poll`; beyond that the oldest is dropped, and counted.
        monotonic: a clock that never leaps, s.
    """

    def __init__(
        self,
        name: str,
        *,
        silence_s: float = 2.0,
        kept: int = 4,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.silence_s = name, silence_s
        self.counters = Counters()
        self.dropped = 0
        """Values that were dropped because `poll` was called too seldom, or because the device was lost."""
        self.reason = "not yet connected"
        """Why it is DISCONNECTED, in plain words; '' while it is CONNECTED."""
        self._monotonic = monotonic
        self._changed = Condition()
        self._values: deque[T] = deque()
        self._kept = kept
        self._thread: Thread | None = None
        self._is_connected = self._is_ending = self._must_reopen = False
        self._valid_s = self._called_s = 0.0

    @property
    def state(self) -> ConnectionState:
        """Return whether the device can be used."""
        return ConnectionState.CONNECTED if self._is_connected else ConnectionState.DISCONNECTED

    @property
    def is_connected(self) -> bool:
        """Return whether the device can be used."""
        return self._is_connected

    def poll(self, wait_s: float = 0.0) -> list[T]:
        """Return what has come since the last call, oldest first; wait at most `wait_s` for it.

        Raises:
            DeviceStuck: the library has not returned for `MAX_CALL_S`.
        """
        if self._thread is None:
            self._called_s = self._monotonic()
            self._thread = Thread(target=self._serve, name=self.name, daemon=True)
            self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._values, wait_s)
            now_s = self._monotonic()
            if now_s - self._called_s > MAX_CALL_S:
                raise DeviceStuck(f"the library of {self.name} has not returned for {MAX_CALL_S:g} s")
            if self._is_connected and now_s - self._valid_s > self.silence_s:
                self._must_reopen = True
                self._lose(f"{self.name} has sent nothing for {self.silence_s:g} s")
            values = list(self._values)
            self._values.clear()
        return values

    def close(self) -> None:
        """Close the device.

        A library that does not return is left behind, in a thread that ends with the process.
        """
        with self._changed:
            self._is_ending = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(END_S)
        self._is_connected, self.reason = False, "closed"

    @abstractmethod
    def _open(self) -> None:
        """Open the device; called by the thread. Raise an OSError that says why it cannot be used."""

    @abstractmethod
    def _read(self) -> T | None:
        """Wait for the next value and return it; None if none has come for a while.

        Raise an OSError if the device is lost.
        """

    @abstractmethod
    def _close(self) -> None:
        """Close what `_open` has opened, even half."""

    def _pause(self, wait_s: float) -> bool:
        """Wait in the thread; return False at once when the device is to be closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_ending, wait_s)
            return not self._is_ending

    def _serve(self) -> None:
        backoff_s = MIN_BACKOFF_S
        while True:
            values = self.counters.values
            try:
                self._call()
                self._open()
                while not (self._is_ending or self._must_reopen):
                    self._call()
                    value = self._read()
                    if value is not None:
                        self._keep(value)
            except OSError as error:
                with self._changed:
                    self._lose(str(error))
            finally:
                with suppress(OSError):
                    self._close()
            backoff_s = MIN_BACKOFF_S if self.counters.values > values else min(2 * backoff_s, MAX_BACKOFF_S)
            self._must_reopen = False
            self._call()
            if not self._pause(backoff_s):
                return

    def _call(self) -> None:
        self._called_s = self._monotonic()

    def _keep(self, value: T) -> None:
        with self._changed:
            if self._must_reopen or self._is_ending:
                return
            if not self._is_connected:
                self._is_connected, self.reason = True, ""
                self.counters.connections += 1
            if len(self._values) == self._kept:
                self._values.popleft()
                self.dropped += 1
            self._values.append(value)
            self._valid_s = self._monotonic()
            self.counters.values += 1
            self._changed.notify_all()

    def _lose(self, reason: str) -> None:
        """Count a loss, or an attempt that failed; the lock is held."""
        if self._is_connected:
            self.counters.losses += 1
        elif not self._must_reopen:
            self.counters.failures += 1
        self._is_connected, self.reason = False, reason
        self.dropped += len(self._values)
        self._values.clear()
