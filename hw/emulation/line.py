"""Runs an emulated device on a line with faults."""

import os
import select
import time
from collections import deque
from threading import RLock, Thread
from types import TracebackType

from robbie_robots.hw.emulation.carrier import Carrier
from robbie_robots.hw.emulation.device import EmulatedDevice, SentFrame
from robbie_robots.hw.emulation.faults import Faults, FaultyWay

# The longest wait without a look at the device, so that a clock that you set takes effect.
MAX_WAIT_S = 0.05
# A host that does not read loses what comes after this many bytes, as on a real line.
MAX_WAITING_BYTES = 65_536
# Bytes of a slow line that are sent at once.
SLOW_PIECE_BYTES = 8
# UARTs understand each other up to about this difference of their bit rates.
MAX_RATE_DIFFERENCE = 0.03
# Start bit, eight data bits, stop bit.
BITS_PER_BYTE = 10


class EmulatedLine:
    """A device on a line, served by a thread: a context manager.

    Args:
        device: the device; it is switched on.
        carrier: what carries its bytes: `PseudoTerminal(link)` or `TcpPort()`.
        faults: what goes wrong from the start; change `line.faults` at any time.
        seed: the same seed gives the same faults.

    Example:
        with EmulatedLine(EmulatedMti(), PseudoTerminal(tmp_path / "imu")) as line:
            driver = ...(line.url)
            line.faults.is_silent = True
            line.unplug()
            line.plug_in()
    """

    def __init__(
        self, device: EmulatedDevice, carrier: Carrier, faults: Faults | None = None, seed: int = 0
    ) -> None:
        self.device, self.way = device, FaultyWay(faults or Faults(), seed)
        self.dropped_bytes = 0
        """Bytes that were lost because the host did not read."""
        self._carrier = carrier
        self._lock = RLock()
        self._due: deque[tuple[float, bytes]] = deque()
        self._waiting = bytearray()
        self._is_plugged_in = self._is_ending = False
        self._wake_read, self._wake_write = os.pipe()
        self._thread = Thread(target=self._serve, name="emulated device")

    @property
    def url(self) -> str:
        """Return where the host finds the line."""
        return self._carrier.url

    @property
    def faults(self) -> Faults:
        """Return what goes wrong now; change its attributes, or set others."""
        return self.way.faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self.way.faults = faults

    @property
    def is_plugged_in(self) -> bool:
        """Return whether a host can find the line."""
        return self._is_plugged_in

    def __enter__(self) -> "EmulatedLine":
        self.device.power_on()
        self.plug_in()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_ending = True
        self._wake()
        self._thread.join()
        self.unplug()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def plug_in(self) -> None:
        """Plug the line in; the device kept its power meanwhile (else call `reset`, too)."""
        with self._lock:
            if not self._is_plugged_in:
                self._carrier.plug_in()
                self._is_plugged_in = True
        self._wake()

    def unplug(self) -> None:
        """Pull the line out."""
        with self._lock:
            if self._is_plugged_in:
                self._carrier.unplug()
                self._is_plugged_in = False
                self._forget()

    def reset(self) -> None:
        """Switch the device off and on; the line stays."""
        with self._lock:
            self._forget()
            self.device.taken()
            self.device.power_on()
        self._wake()

    def _forget(self) -> None:
        self._due.clear()
        self._waiting.clear()

    def _wake(self) -> None:
        os.write(self._wake_write, b"x")

    def _serve(self) -> None:
        while not self._is_ending:
            with self._lock:
                wait_s = self._turn()
                readable = self._carrier.readable()
                writable = readable if self._waiting else []
            # A line that is pulled out meanwhile wakes us, or its descriptor is found closed.
            try:
                ready, _, _ = select.select([self._wake_read, *readable], writable, [], wait_s)
            except (OSError, ValueError):
                continue
            if self._wake_read in ready:
                os.read(self._wake_read, 4096)

    def _turn(self) -> float:
        """Do what is due on the device and on the line. Return how long nothing else will be, s."""
        received = self._carrier.read() if self._is_plugged_in else b""
        if self._carrier.was_opened():
            self._waiting += self.faults.garbage_at_start
        if received and not self.faults.is_silent:
            self.device.receive(self.way.scramble(received) if self._has_wrong_rate() else received)
        next_s = self.device.step()
        now_s = time.monotonic()
        for frame in self.device.sent():
            self._send(frame, now_s)
        while self._due and self._due[0][0] <= now_s:
            self._waiting += self._due.popleft()[1]
        if self._waiting and self._is_plugged_in:
            del self._waiting[: self._carrier.write(bytes(self._waiting))]
        self.dropped_bytes += max(0, len(self._waiting) - MAX_WAITING_BYTES)
        del self._waiting[MAX_WAITING_BYTES:]
        wait_s = MAX_WAIT_S
        if next_s is not None:
            wait_s = min(wait_s, self.device.clock.true_s(next_s) - now_s)
        if self._due:
            wait_s = min(wait_s, self._due[0][0] - now_s)
        return max(0.0, wait_s)

    def _send(self, frame: SentFrame, now_s: float) -> None:
        """Send a frame, as the faults let it: later frames never overtake it."""
        if self.faults.is_silent or not self._is_plugged_in:
            return
        data = frame.data
        arriving = self.way.damage(self.way.scramble(data) if self._has_wrong_rate() else data)
        sent_s = now_s if frame.at_s is None else self.device.clock.true_s(frame.at_s)
        due_s = sent_s + self.way.delay_s()
        if self._due:
            due_s = max(due_s, self._due[-1][0])
        rate = self.faults.bytes_per_s
        if rate is None:
            self._due.append((due_s, arriving))
            return
        for begin in range(0, len(arriving), SLOW_PIECE_BYTES):
            piece = arriving[begin : begin + SLOW_PIECE_BYTES]
            due_s += len(piece) / rate
            self._due.append((due_s, piece))

    def _has_wrong_rate(self) -> bool:
        if self.faults.has_wrong_rate:
            return True
        host, device = self._carrier.host_bit_rate(), self.device.bit_rate
        if not host or device is None:
            return False
        return abs(host - device) > MAX_RATE_DIFFERENCE * device
