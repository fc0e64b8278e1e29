"""Base of all emulated devices: power, a clock, and bytes in and out."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

# An emulator that a busy machine let wait no longer than this makes up for the beats that it has missed.
MAX_LATE_S = 0.5


class EmulatedClock:
    """A device's clock: it starts where you set it and runs a little fast or slow.

    Args:
        start_s: what it shows now. Set it shortly before the end of the device's stamps to see them wrap.
        drift: how much too fast it runs: 1e-4 for 0.1 ms each second.
        monotonic: the true time, s.
    """

    def __init__(
        self, start_s: float = 0.0, drift: float = 0.0, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._monotonic, self._rate = monotonic, 1.0 + drift
        self.set(start_s)

    def set(self, now_s: float) -> None:
        """Let the clock show this time now."""
        self._shown_s, self._since_s = now_s, self._monotonic()

    def now_s(self) -> float:
        """Return what the clock shows. It never wraps; the device's stamps do."""
        return self.at_s(self._monotonic())

    def at_s(self, monotonic_s: float) -> float:
        """Return what the clock shows at a true time."""
        return self._shown_s + (monotonic_s - self._since_s) * self._rate

    def true_s(self, shown_s: float) -> float:
        """Return the true time at which the clock shows `shown_s`."""
        return self._since_s + (shown_s - self._shown_s) / self._rate


def oldest_due(due_s: float, period_s: float, now_s: float) -> float:
    """Return the oldest time of a regular beat that is not over for longer than `MAX_LATE_S`.

    A device leaves out no beat, however busy the machine of its emulator is. Only after a long pause, such as
    that of a stopped process, would it take too long to make up for all.

    Args:
        due_s: the first beat that is not done.
        period_s: from beat to beat.
        now_s: the time now.
    """
    return due_s + period_s * max(0, math.ceil((now_s - MAX_LATE_S - due_s) / period_s))


class SentFrame(NamedTuple):
    """A frame on its way to the host.

    Attributes:
        data: its bytes.
        at_s: when, on the device's clock, the device sends it; None: as soon as it is made.
    """

    data: bytes
    at_s: float | None


class EmulatedDevice(ABC):
    """One device, without the line on which its bytes travel.

    A subclass answers in `receive` and sends by itself in `step`. It hands each whole frame to `send`:
    faults are ordered by frame. It has no thread: an `EmulatedLine` calls it, or a test does.

    Example:
        class Beacon(EmulatedDevice):
            def power_on(self) -> None:
                self._next_s = self.clock.now_s()

            def receive(self, data: bytes) -> None:
                pass

            def step(self) -> float:
                now_s = self.clock.now_s()
                while self._next_s <= now_s:
                    self.send(b"here I am")
                    self._next_s += 0.1
                return self._next_s
    """

    bit_rate: int | None = None
    """At what bit/s it sends and receives now; None if its line has no rate (USB, TCP)."""

    def __init__(self, clock: EmulatedClock | None = None) -> None:
        self.clock = clock or EmulatedClock()
        self._sent: list[SentFrame] = []

    @abstractmethod
    def power_on(self) -> None:
        """Forget all that was set and start as after power-on."""

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Take bytes from the host, in pieces of any length; answer by `send`."""

    def step(self) -> float | None:
        """Do what is due by now. Return when, on `clock`, the next thing is due; None: nothing is.

        What becomes due meanwhile is for the next step: on a busy machine, the step would never end.
        """
        return None

    def send(self, frame: bytes, at_s: float | None = None) -> None:
        """Send a whole frame to the host.

        Args:
            frame: its bytes.
            at_s: when the device sends it, on its clock; None: now. Tell it if you can: the machine of an
                emulator may be late, and making a frame takes a while. A device is not late.
        """
        self._sent.append(SentFrame(frame, at_s))

    def sent(self) -> list[SentFrame]:
        """Return the frames sent since the last call, and when."""
        sent, self._sent = self._sent, []
        return sent

    def taken(self) -> list[bytes]:
        """Return the bytes of the frames sent since the last call."""
        return [frame.data for frame in self.sent()]
