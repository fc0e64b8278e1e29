"""An emulated device on a line in simulated time: without threads, and the same in each run."""

from collections import deque

from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.faults import Faults, FaultyWay
from robbie_robots.hw.emulation.line import BITS_PER_BYTE, MAX_RATE_DIFFERENCE


class SteppedTime:
    """A clock that a `SteppedLine` moves.

    Example:
        clock = SimulatedTime()
        device = EmulatedLms2xx(measure, EmulatedClock(monotonic=clock))
        line = SteppedLine(device, clock)
    """

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        """Return the time now, s."""
        return self.now_s


class SteppedLine(Port):
    """A line that is the driver's port, too: while the driver waits for bytes, simulated time passes.

    On a line with a bit rate each byte takes its time, and a frame arrives when its last byte does.

    Args:
        device: the device, whose clock runs by `clock`; it is switched on.
        clock: the time.
        faults: what goes wrong; change `faults` at any time.
        seed: the same seed gives the same faults.
    """

    def __init__(
        self, device: EmulatedDevice, clock: SteppedTime, faults: Faults | None = None, seed: int = 0
    ) -> None:
        self.url = "simulated"
        self._device, self._clock = device, clock
        self._way = FaultyWay(faults or Faults(), seed)
        self._host_rate = 0
        self._free_s = self._arrives_s = 0.0
        self._due: deque[tuple[float, bytes]] = deque()
        device.power_on()

    @property
    def faults(self) -> Faults:
        """Return what goes wrong now."""
        return self._way.faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._way.faults = faults

    def opened(self, _url: str, bit_rate: int) -> Port:
        """Return the port: what a driver calls to open it."""
        self._host_rate = bit_rate
        return self

    @property
    def descriptor(self) -> int | None:
        """Return None: no second process can write to it."""
        return None

    def read(self, wait_s: float) -> bytes:
        """Return what has arrived; let up to `wait_s` pass until something has."""
        end_s = self._clock.now_s + max(0.0, wait_s)
        while True:
            next_s = self._device.step()
            self._send()
            arrived = b""
            while self._due and self._due[0][0] <= self._clock.now_s:
                arrived += self._due.popleft()[1]
            if arrived or self._clock.now_s >= end_s:
                return arrived
            self._pass([end_s, self._due[0][0]] if self._due else [end_s], next_s)

    def pause(self, wait_s: float) -> None:
        """Let this time pass."""
        end_s = self._clock.now_s + wait_s
        while self._clock.now_s < end_s:
            next_s = self._device.step()
            self._send()
            self._pass([end_s], next_s)

    def write(self, data: bytes) -> None:
        """Let the device receive bytes at once."""
        self._device.receive(self._way.scramble(data) if self._has_wrong_rate() else data)
        self._send()

    def set_bit_rate(self, bit_rate: int) -> None:
        """Change the host's rate."""
        self._host_rate = bit_rate

    def drain(self, quiet_s: float, limit_s: float) -> None:
        """Read and forget what still arrives."""
        end_s = self._clock.now_s + limit_s
        while self._clock.now_s < end_s and self.read(quiet_s):
            pass

    def set_motor_line(self, is_high: bool) -> None:
        """Do nothing: nobody looks at this line."""

    def close(self) -> None:
        """Forget what was not read."""
        self._due.clear()

    def _pass(self, ends_s: list[float], device_s: float | None) -> None:
        """Let time pass until the earliest of some times, or until the device's next step on its clock."""
        until_s = ends_s if device_s is None else [*ends_s, self._device.clock.true_s(device_s)]
        # A rounding error of the clocks must not stop time.
        self._clock.now_s = max(min(until_s), self._clock.now_s + 1e-9)

    def _send(self) -> None:
        for data, at_s in self._device.sent():
            sent = self._way.scramble(data) if self._has_wrong_rate() else data
            rate = self._device.bit_rate
            sent_s = self._clock.now_s if at_s is None else self._device.clock.true_s(at_s)
            self._free_s = max(self._free_s, sent_s)
            self._free_s += len(data) * BITS_PER_BYTE / rate if rate else 0.0
            self._arrives_s = max(self._arrives_s, self._free_s + self._way.delay_s())
            self._due.append((self._arrives_s, self._way.damage(sent)))

    def _has_wrong_rate(self) -> bool:
        device = self._device.bit_rate
        return device is not None and abs(self._host_rate - device) > MAX_RATE_DIFFERENCE * device
