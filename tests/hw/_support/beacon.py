"""A device that sends numbered frames with stamps, for tests of what all devices share."""

import struct
from collections.abc import Callable

from robbie_robots.hw.connection.device import PluggableDevice
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder, Framing

MARKER = b"\xaa\x55"
BODY = struct.Struct("<II")


def frame(number: int, stamp_ms: int = 0) -> bytes:
    inside = bytes([BODY.size]) + BODY.pack(number, stamp_ms)
    return MARKER + inside + bytes([sum(inside) & 0xFF])


class BeaconFraming(Framing[int]):
    start = MARKER
    head_bytes = 3

    def length(self, head: bytes) -> int | None:
        return len(MARKER) + 1 + head[2] + 1 if len(head) == 3 else None

    def parse(self, frame: bytes) -> int:
        if sum(frame[2:-1]) & 0xFF != frame[-1] or frame[2] != BODY.size:
            raise DamagedFrame
        number: int = BODY.unpack(frame[3:-1])[0]
        return number


class EmulatedBeacon(EmulatedDevice):
    """Answers `?` with `!`, and sends a frame each `period_s` from then on."""

    def __init__(self, period_s: float = 0.01, clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self.period_s = period_s

    def power_on(self) -> None:
        self.number, self.next_s = 0, None

    number: int
    next_s: float | None

    def receive(self, data: bytes) -> None:
        if b"?" in data:
            self.send(b"!")
            self.next_s = self.clock.now_s()

    def step(self) -> float | None:
        while self.next_s is not None and self.next_s <= self.clock.now_s():
            self.send(frame(self.number, int(self.next_s * 1000)))
            self.number += 1
            self.next_s += self.period_s
        return self.next_s


class Beacon(PluggableDevice[int]):
    """The driver: returns the numbers."""

    def __init__(
        self, url: str, bit_rate: int = 115_200, open_port: Callable[[str, int], Port] = Port
    ) -> None:
        super().__init__(url, bit_rate, silence_s=0.3, open_port=open_port)
        self.frames = FrameDecoder(BeaconFraming())

    def _start(self, port: Port) -> None:
        port.write(b"?")
        heard = b""
        while b"!" not in heard:
            more = port.read(0.3)
            if not more:
                raise DeviceSilent("no answer")
            heard += more

    def _take(self, data: bytes) -> list[int]:
        return self.frames.feed(data)

    def _reset(self) -> None:
        self.frames.reset()
