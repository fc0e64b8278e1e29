"""An emulated Hokuyo laser with SCIP 2.

Source: Hokuyo Automatic Co., Communication Protocol Specification for SCIP2.0 Standard.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice, oldest_due

LINE_CHARACTERS = 64
STAMP_MODULUS = 1 << 24
# A laser that cannot measure a range sends an error code below its least range.
NO_RANGE = 1
BRIGHTNESS = 1000
# From the end of a turn until its sweep is sent.
PROCESSING_S = 0.025
# A sweep is made this long before it is sent, because making it takes an emulator a while.
MAKING_S = 0.005
# It is tried again after this time if the ranges are not known yet.
RETRY_S = 0.005
REBOOT_WITHIN_S = 1.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LaserModel:
    """A laser's description of itself, the answer to PP.

    Attributes:
        name: the model.
        least_mm: shortest range.
        most_mm: longest range.
        steps_per_turn: steps of a full circle.
        first_step: first step that it measures.
        last_step: last step that it measures.
        front_step: the step straight ahead; steps count counter-clockwise.
        turns_per_min: turns of its mirror.
    """

    name: str
    least_mm: int
    most_mm: int
    steps_per_turn: int
    first_step: int
    last_step: int
    front_step: int
    turns_per_min: int

    @property
    def turn_s(self) -> float:
        """Return the time of a turn of the mirror."""
        return 60.0 / self.turns_per_min

    @property
    def latency_s(self) -> float:
        """Return how much later than its stamp a sweep is sent."""
        return self.turn_s + PROCESSING_S

    def angles_rad(self) -> Array:
        """Return the direction of each step: (last_step - first_step + 1,)."""
        steps = np.arange(self.first_step, self.last_step + 1)
        return (steps - self.front_step) * 2 * math.pi / self.steps_per_turn


URG_04LX = LaserModel("URG-04LX(Hokuyo Automatic Co., Ltd.)", 20, 5600, 1024, 44, 725, 384, 600)
UTM_30LX = LaserModel("UTM-30LX(Hokuyo Automatic Co., Ltd.)", 23, 60_000, 1440, 0, 1080, 540, 2400)


@dataclass
class _Stream:
    """A measurement that was asked for.

    Attributes:
        command: as the host sent it, without the number of sweeps.
        left: sweeps still to send; None: until the host ends it.
    """

    command: str
    left: int | None


class EmulatedHokuyo(EmulatedDevice):
    """A laser that measures with every turn of its mirror, and sends what a host asks for.

    A sweep shows one moment, that of its stamp. It is sent when the turn that began then is over, and
    processed.

    Args:
        model: which laser.
        measure: gets the true time of a sweep's stamp, s, which is over; returns the ranges in the directions
            of `model.angles_rad()`, m; not finite: none.
        clock: its clock.
        is_known: gets the same; returns whether `measure` can tell the ranges yet. If not, the sweep is late.

    Attributes:
        is_on: whether it measures.
        sweeps: number of sweeps that it has sent.
    """

    def __init__(
        self,
        model: LaserModel,
        measure: Callable[[float], Array],
        clock: EmulatedClock | None = None,
        is_known: Callable[[float], bool] = lambda _: True,
    ) -> None:
        super().__init__(clock)
        self.model, self.sweeps = model, 0
        self._measure, self._is_known = measure, is_known
        self.power_on()

    def power_on(self) -> None:
        """Be switched off, and wait for a command."""
        self.is_on = self._is_telling_time = False
        self._received = b""
        self._stream: _Stream | None = None
        self._turn = 0
        self._began_s = self.clock.now_s()
        self._asked_to_reboot_s = -math.inf

    def receive(self, data: bytes) -> None:
        """Answer commands, each of which ends with a line feed or a carriage return."""
        *lines, self._received = (self._received + data.replace(b"\r", b"\n")).split(b"\n")
        for line in lines:
            if line:
                self._obey(line.decode("ascii", "replace"))

    def step(self) -> float | None:
        """Make the sweep of each turn that the host wants, shortly before it is to be sent."""
        made_after_s = self.model.latency_s - MAKING_S
        now_s = self.clock.now_s()
        while self._stream is not None:
            self._began_s = oldest_due(self._began_s, self.model.turn_s, now_s - made_after_s)
            if now_s < self._began_s + made_after_s:
                return self._began_s + made_after_s
            if self._turn % (1 + int(self._stream.command[12])) == 0:
                if not self._is_known(self.clock.true_s(self._began_s)):
                    return now_s + RETRY_S
                self._send_sweep(self._stream)
            self._turn += 1
            self._began_s += self.model.turn_s
        return None

    def _obey(self, command: str) -> None:
        kind = command[:2]
        if command == "SCIP2.0":
            self._answer(command, "0E")
        elif kind in ("VV", "PP", "II"):
            self._answer(command, "00", [_told(name, value) for name, value in self._about(kind)])
        elif kind == "BM":
            self._answer(command, "02" if self.is_on else "00")
            self.is_on = True
        elif kind in ("QT", "RS"):
            self.is_on, self._stream = False, None
            self._answer(command, "00")
        elif kind == "RB":
            self._reboot(command)
        elif command == "%ST":
            self._answer(command, "00", [_summed(self._state())])
        elif kind == "TM":
            self._is_telling_time = command != "TM2"
            self._answer(
                command,
                "00",
                [_summed(coded(self._stamp(self.clock.now_s()), 4))] if command == "TM1" else [],
            )
        elif kind in ("GD", "GS", "GE", "MD", "MS", "ME"):
            self._begin(command)
        else:
            self._answer(command, "0E")

    def _begin(self, command: str) -> None:
        kind, numbers = command[0], command[2:]
        wanted = 10 if kind == "G" else 13
        if len(numbers) != wanted or not numbers.isdigit():
            self._answer(command, "0C" if len(numbers) < wanted else "0D")
            return
        first, last = int(command[2:6]), int(command[6:10])
        if not self.model.first_step <= first <= last <= self.model.last_step:
            self._answer(command, "04")
        elif kind == "M":
            count = int(command[13:15])
            self.is_on, self._turn = True, 0
            self._stream = _Stream(command[:13], count or None)
            self._began_s = self.clock.now_s()
            self._answer(command, "00")
        elif not self.is_on:
            self._answer(command, "10")
        else:
            self._answer(command, "00", self._data(command, self.clock.now_s()))

    def _send_sweep(self, stream: _Stream) -> None:
        if stream.left is not None:
            stream.left -= 1
        self._answer(
            f"{stream.command}{stream.left or 0:02d}",
            "99",
            self._data(stream.command, self._began_s),
            self._began_s + self.model.latency_s,
        )
        self.sweeps += 1
        if stream.left == 0:
            self._stream = None

    def _data(self, command: str, measured_s: float) -> list[str]:
        """Return the stamp and the lines of the sweep that was measured at a time."""
        first, last, merged = int(command[2:6]), int(command[6:10]), max(1, int(command[10:12]))
        steps = slice(first - self.model.first_step, last + 1 - self.model.first_step)
        nearest = _merged(self._ranges_mm(self.clock.true_s(measured_s))[steps], merged)
        kind = command[1]
        if kind == "S":
            text = all_coded(np.minimum(nearest, 4095), 2)
        elif kind == "E":
            text = all_coded(np.column_stack([nearest, np.full_like(nearest, BRIGHTNESS)]), 3)
        else:
            text = all_coded(nearest, 3)
        lines = [text[at : at + LINE_CHARACTERS] for at in range(0, len(text), LINE_CHARACTERS)]
        return [_summed(coded(self._stamp(measured_s), 4)), *map(_summed, lines)]

    def _ranges_mm(self, measured_s: float) -> NDArray[np.int64]:
        measured = self._measure(measured_s) * 1000
        seen = np.isfinite(measured) & (measured >= self.model.least_mm) & (measured <= self.model.most_mm)
        return np.where(seen, np.round(np.where(seen, measured, 0)), NO_RANGE).astype(np.int64)

    def _about(self, kind: str) -> list[tuple[str, str]]:
        model = self.model
        return {
            "VV": [("VEND", "Hokuyo Automatic Co., Ltd."), ("PROD", model.name), ("FIRM", "1.0.0"),
                   ("PROT", "SCIP 2.0"), ("SERI", "H0000001")],
            "PP": [("MODL", model.name), ("DMIN", str(model.least_mm)), ("DMAX", str(model.most_mm)),
                   ("ARES", str(model.steps_per_turn)), ("AMIN", str(model.first_step)),
                   ("AMAX", str(model.last_step)), ("AFRT", str(model.front_step)),
                   ("SCAN", str(model.turns_per_min))],
            "II": [("MODL", model.name), ("LASR", "ON" if self.is_on else "OFF"),
                   ("SCSP", f"Initial({model.turns_per_min}[rpm])<-Default setting by user"),
                   ("MESM", "IDLE" if self._stream is None else "CLASSIC"), ("SBPS", "USB only"),
                   ("TIME", f"{self._stamp(self.clock.now_s()):06X}"), ("STAT", "Sensor works well.")],
        }[kind]  # fmt: skip

    def _state(self) -> str:
        """Return the answer to %ST, a command of SCIP 2.2."""
        if self._is_telling_time:
            return "002"
        if self._stream is not None:
            return "004"
        return "003" if self.is_on else "000"

    def _reboot(self, command: str) -> None:
        """Begin again at the second request within a second."""
        now_s = self.clock.now_s()
        is_second = now_s - self._asked_to_reboot_s < REBOOT_WITHIN_S
        self._answer(command, "00" if is_second else "01")
        if is_second:
            self.power_on()
        else:
            self._asked_to_reboot_s = now_s

    @staticmethod
    def _stamp(shown_s: float) -> int:
        return int(shown_s * 1000) % STAMP_MODULUS

    def _answer(
        self, echo: str, status: str, lines: list[str] | None = None, at_s: float | None = None
    ) -> None:
        text = "\n".join([echo, _summed(status), *(lines or [])]) + "\n\n"
        self.send(text.encode("ascii", "replace"), at_s)


def _merged(ranges_mm: NDArray[np.int64], steps: int) -> NDArray[np.int64]:
    """Return the nearest range of each group of steps; an error code only if there is no range.

    What is left over at the end is a smaller group.
    """
    none = np.iinfo(np.int64).max
    groups = np.where(ranges_mm == NO_RANGE, none, ranges_mm)
    nearest = np.minimum.reduceat(groups, np.arange(0, len(groups), steps))
    return np.where(nearest == none, NO_RANGE, nearest)


def coded(value: int, characters: int) -> str:
    """Return a number in characters of six bits, the most significant first."""
    return "".join(chr((value >> 6 * place & 0x3F) + 0x30) for place in reversed(range(characters)))


def all_coded(values: NDArray[np.int64], characters: int) -> str:
    """Return numbers one after the other, each as `coded`."""
    digits = values.reshape(-1, 1) >> 6 * np.arange(characters)[::-1] & 0x3F
    return (digits + 0x30).astype(np.uint8).tobytes().decode("ascii")


def checksum(text: str) -> str:
    """Return the checksum character of a text."""
    return chr((sum(text.encode("ascii", "replace")) & 0x3F) + 0x30)


def _summed(text: str) -> str:
    return text + checksum(text)


def _told(name: str, value: str) -> str:
    text = f"{name}:{value}"
    return f"{text};{checksum(text)}"
