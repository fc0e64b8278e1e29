"""A device that may be pulled out and plugged in again at any time."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, Generic, TypedDict, TypeVar

from strenum import StrEnum

from robbie_mp.base.device_links import monotonic, sleep
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.connection.port import Port

# The wait between two attempts to connect doubles from the first to the last of these.
MIN_BACKOFF_S = 0.1
MAX_BACKOFF_S = 0.8

T = TypeVar("T")


class ConnectionState(StrEnum):
    """Whether a device can be used."""

    CONNECTED = "CONNECTED"
    """It has answered, and it sends."""

    DISCONNECTED = "DISCONNECTED"
    """It cannot be opened, does not answer, or has fallen silent; the driver tries again by itself."""


@dataclass
class Counters:
    """Counts of events since the driver started.

    Attributes:
        connections: how often the device was found and started.
        losses: how often it was lost after that.
        failures: attempts to connect that failed.
        bytes_received: bytes received.
        values: measurements received.
        damaged: frames that were damaged on the way.
        skipped_bytes: bytes that belonged to no valid frame.
    """

    connections: int = 0
    losses: int = 0
    failures: int = 0
    bytes_received: int = 0
    values: int = 0
    damaged: int = 0
    skipped_bytes: int = 0


class DeviceOptions(TypedDict, total=False):
    """What every driver takes, and passes on to `PluggableDevice`.

    Attributes:
        clock: the time for stamps, s.
        silence_s: the device counts as lost when nothing valid arrives for this time.
        monotonic: a clock that never leaps, s, for time-outs.
        open_port: opens the port, for tests.
    """

    clock: Callable[[], float]
    silence_s: float
    monotonic: Callable[[], float]
    open_port: Callable[[str, int], Port]


class PluggableDevice(ABC, Generic[T]):
    """A device on a port that reconnects by itself, with backoff. Call `poll` again and again.

    It starts DISCONNECTED, and the port need not exist yet. After each opening of the port, `_start` talks
    to the device until it sends; then `_take` gets all bytes that arrive. If a port breaks, or nothing
    valid arrives for `silence_s`, the port is closed, and all that was heard half is forgotten.

    Args:
        url: the port: see `Port`.
        bit_rate: bit/s at the start, on a serial line.
        clock: see `DeviceOptions`.
        silence_s: likewise; None: `SILENCE_S`.
        monotonic: likewise.
        open_port: likewise.
    """

    SILENCE_S: ClassVar[float] = 1.0
    """What `silence_s` is unless it is given."""

    def __init__(
        self,
        url: str,
        bit_rate: int = 115_200,
        *,
        clock: Callable[[], float] = time.time,
        silence_s: float | None = None,
        monotonic: Callable[[], float] = monotonic,
        open_port: Callable[[str, int], Port] = Port,
    ) -> None:
        self.url, self.bit_rate = url, bit_rate
        self.silence_s = self.SILENCE_S if silence_s is None else silence_s
        self.counters = Counters()
        self.reason = "not yet connected"
        """Why it is DISCONNECTED, in plain words; '' while it is CONNECTED."""
        self._clock, self._monotonic, self._open_port = clock, monotonic, open_port
        self._port: Port | None = None
        self._backoff_s, self._next_attempt_s = MIN_BACKOFF_S, monotonic()
        self._valid_s = self._read_s = 0.0
        self.gather_s = 0.0
        """Least time between two reads. Each read has a price of its own, whatever it brings."""

    @property
    def state(self) -> ConnectionState:
        """Return whether the device can be used."""
        return ConnectionState.DISCONNECTED if self._port is None else ConnectionState.CONNECTED

    @property
    def is_connected(self) -> bool:
        """Return whether the device can be used."""
        return self._port is not None

    @property
    def port(self) -> Port:
        """Return the open port, for the driver itself.

        Raises:
            DeviceSilent: there is none.
        """
        if self._port is None:
            raise DeviceSilent(f"the device at {self.url} is not connected: {self.reason}")
        return self._port

    def poll(self, wait_s: float = 0.0) -> list[T]:
        """Return what the device has measured since the last call, oldest first.

        Waits at most `wait_s` for data; an attempt to connect may take longer, as long as `_start` does.
        Never raises because of the device: see `state`, `reason` and `counters`.
        """
        end_s = self._monotonic() + wait_s
        if self._port is None:
            if not self._connect(end_s):
                return []
            end_s = self._monotonic()  # measurements may have come with the answers
        assert self._port is not None
        try:
            self._gather(self._port, end_s)
            data = self._port.read(end_s - self._monotonic())
            self._read_s = self._monotonic()
            self.counters.bytes_received += len(data)
            values = self._take(data)
            now_s = self._monotonic()
            if values or self._is_alive():
                self._valid_s = now_s
            elif now_s - self._valid_s > self.silence_s:
                raise DeviceSilent(
                    f"the device at {self.url} has sent nothing valid for {self.silence_s:g} s"
                )
        except OSError as error:
            self._lose(error)
            return []
        self.counters.values += len(values)
        return values

    def send(self, data: bytes) -> bool:
        """Send bytes to the device. Return False if it is not connected; a port that breaks is closed."""
        if self._port is None:
            return False
        try:
            self._port.write(data)
        except OSError as error:
            self._lose(error)
            return False
        return True

    def close(self) -> None:
        """Switch the device off if it still answers, and close the port."""
        if self._port is not None:
            with suppress(OSError):
                self._stop()
            self._port.close()
            self._port = None
            self._reset()
        self.reason = "closed"

    @abstractmethod
    def _start(self, port: Port) -> None:
        """Talk to the device after the port was opened, until it sends measurements.

        Must end within a few seconds. Raise DeviceFault or DeviceSilent if it does not answer as it should.
        """

    @abstractmethod
    def _take(self, data: bytes) -> list[T]:
        """Take received bytes, in pieces of any length, even empty; return the measurements now whole.

        Raise DeviceFault if the device must be started again.
        """

    @abstractmethod
    def _reset(self) -> None:
        """Forget what came over a port that is closed now: half a frame, the device's clock, its state."""

    def _stop(self) -> None:
        """Switch the device off before its port is closed."""

    def _is_alive(self) -> bool:
        """Return True once after something valid arrived that is no measurement, such as an answer."""
        return False

    def _gather(self, port: Port, end_s: float) -> None:
        """Let more bytes come, until the next read is due, or until `end_s`."""
        if self.gather_s:
            until_s = min(end_s, self._read_s + self.gather_s)
            if (wait_s := until_s - self._monotonic()) > 0:
                port.pause(wait_s)

    def _connect(self, end_s: float) -> bool:
        """Try to connect if it is time to, else wait until `end_s` at most. Return whether it worked."""
        until_s = min(end_s, self._next_attempt_s)
        if (wait_s := until_s - self._monotonic()) > 0:
            sleep(wait_s)
        if self._monotonic() < self._next_attempt_s:
            return False
        port = None
        try:
            self._reset()
            port = self._open_port(self.url, self.bit_rate)
            self._start(port)
        except OSError as error:
            if port is not None:
                port.close()
            self.counters.failures += 1
            self._wait_after(error)
            return False
        self._port, self.reason = port, ""
        self._backoff_s, self._valid_s = MIN_BACKOFF_S, self._monotonic()
        self.counters.connections += 1
        return True

    def _lose(self, error: OSError) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None
        self._reset()
        self.counters.losses += 1
        self._wait_after(error)

    def _wait_after(self, error: OSError) -> None:
        self.reason = str(error)
        self._next_attempt_s = self._monotonic() + self._backoff_s
        self._backoff_s = min(2 * self._backoff_s, MAX_BACKOFF_S)
