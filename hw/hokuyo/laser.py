"""Hokuyo's laser range finders on a serial port, USB or TCP, such as URG-04LX, UTM-30LX and UST-10LX."""

import math
from contextlib import suppress

from strenum import StrEnum
from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.clock import DeviceClock
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.hokuyo.scip import (
    STAMP_BITS,
    DamagedLine,
    ReplyReader,
    ScipReply,
    meaning,
    measurement,
    parameters,
)
from robbie_robots.hw.laser import DeviceSweep, LaserGeometry
from robbie_robots.hw.pluggable_laser import PluggableLaser, ranges_in_metres

BIT_RATE = 115_200
# A laser answers a command within this time; an earlier stream that still runs may delay the first answer.
ANSWER_S = 1.0
# Statuses of BM: switched on, and on already.
ON = ("00", "02")


class SentMeasurements(StrEnum):
    """The choice of measurements that the laser sends."""

    RANGES = "MD"
    """Ranges, three characters each."""

    SHORT_RANGES = "MS"
    """Ranges up to 4.095 m, two characters each: for a slow line."""

    INTENSITIES = "ME"
    """Ranges and intensities. Not all lasers know it; some halve their rate."""


class HokuyoLaser(PluggableLaser):
    """A laser that streams sweeps over its whole field of view.

    Args:
        url: "/dev/ttyACM0", or "socket://192.168.0.10:10940": see `Port`.
        data: what to measure.
        merge: neighbouring steps that the laser merges into one beam, the nearest of their ranges.
        skip: sweeps that the laser skips after each one that it sends, 0 to 9.
        latency_s: the shortest time between the laser's stamp of a sweep and its first byte here.
        options: see `DeviceOptions`.

    Example:
        with closing(HokuyoLaser("/dev/ttyACM0")) as laser:
            sweep = laser.scan()
    """

    def __init__(
        self,
        url: str,
        *,
        data: SentMeasurements = SentMeasurements.RANGES,
        merge: int = 1,
        skip: int = 0,
        latency_s: float = 0.0,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, BIT_RATE, **options)
        if not (1 <= merge <= 99 and 0 <= skip <= 9):
            raise ValueError(f"merge must be 1 to 99 and skip 0 to 9, not {merge} and {skip}")
        self.identity: dict[str, str] = {}
        """The laser's description of itself: MODL, SERI, FIRM and others."""
        self._data, self._merge, self._skip = data, merge, skip
        self._stamps = DeviceClock(2**STAMP_BITS / 1000, 0.001, latency_s)
        self._reader = ReplyReader()
        # What arrived together with the answer to the last command.
        self._early: list[ScipReply] = []
        self._request = ""

    def _start(self, port: Port) -> None:
        """Ask the laser for its geometry and start the stream."""
        # The oldest lasers must be switched to SCIP 2.0 first. An earlier stream may still be running.
        port.write(b"SCIP2.0\n")
        self._answer(port, "QT")
        self.identity = _tolerant(self._answer(port, "VV"))
        try:
            told = parameters(self._answer(port, "PP").lines)
            first, last = self._set_geometry(told)
        except (KeyError, ValueError, ZeroDivisionError) as error:
            raise DeviceFault(f"the laser does not report its geometry: {error!r}") from error
        on = self._answer(port, "BM", ON)
        self._request = f"{self._data}{first:04d}{last:04d}{self._merge:02d}{self._skip}00"
        self._answer(port, self._request, ON if on.status == "02" else ("00",))

    def _take(self, data: bytes) -> list[DeviceSweep]:
        """Return the sweeps that are whole now, without the damaged ones."""
        sweeps = []
        early, self._early = self._early, []
        for reply in [*early, *self._reader.feed(data, self._clock())]:
            # Each sweep repeats the command, with the number of sweeps that remain.
            if reply.echo[:-2] != self._request[:-2]:
                continue
            if reply.status == "00":
                continue
            if reply.status != "99" and not reply.lines:
                raise DeviceFault(f"the laser has stopped with {meaning(reply.status)}")
            try:
                sweeps.append(self._sweep(reply))
            except DamagedLine:
                self._reader.damaged += 1
        self.counters.damaged, self.counters.skipped_bytes = self._reader.damaged, self._reader.skipped_bytes
        return sweeps

    def _reset(self) -> None:
        self._reader.forget()
        self._early.clear()
        self._stamps.forget()

    def _stop(self) -> None:
        """Switch the laser off."""
        self.port.write(b"QT\n")

    def _sweep(self, reply: ScipReply) -> DeviceSweep:
        if reply.status != "99":
            raise DamagedLine(f"a sweep with {meaning(reply.status)}")
        measured, geometry = measurement(reply), self.geometry
        if len(measured.ranges_mm) != geometry.beams:
            raise DamagedLine(f"a sweep of {len(measured.ranges_mm)} beams instead of {geometry.beams}")
        return DeviceSweep(
            self._stamps.stamp_s(measured.stamp_ms / 1000, reply.arrived_s),
            ranges_in_metres(measured.ranges_mm, 0.001, geometry),
            None if measured.intensities is None else measured.intensities.astype("float32"),
        )

    def _set_geometry(self, told: dict[str, str]) -> tuple[int, int]:
        """Take over the geometry that a laser told; return the first and the last step.

        The laser's steps count counter-clockwise.
        """
        steps, front = int(told["ARES"]), int(told["AFRT"])
        first, last = int(told["AMIN"]), int(told["AMAX"])
        step_rad = 2 * math.pi / steps
        if not 0 <= first < last < 10_000:
            raise ValueError(f"steps {first} to {last}")
        self.period_s = 60.0 / int(told["SCAN"]) * (1 + self._skip)
        self.time_increment_s = 60.0 / int(told["SCAN"]) / steps * self._merge
        most_mm = int(told["DMAX"])
        if self._data is SentMeasurements.SHORT_RANGES:
            most_mm = min(most_mm, 4095)
        self._geometry = LaserGeometry(
            angle_min_rad=(first - front + (self._merge - 1) / 2) * step_rad,
            angle_increment_rad=step_rad * self._merge,
            beams=(last - first) // self._merge + 1,
            range_min_m=int(told["DMIN"]) / 1000.0,
            range_max_m=most_mm / 1000.0,
        )
        return first, last

    def _answer(self, port: Port, command: str, good: tuple[str, ...] = ("00",)) -> ScipReply:
        """Send a command and return the reply to it; skip the rest of an earlier stream.

        Raises:
            DeviceSilent: the laser does not answer in time.
            DeviceFault: it refuses the command.
        """
        port.write(command.encode() + b"\n")
        end_s = monotonic() + ANSWER_S
        while (left_s := end_s - monotonic()) > 0:
            replies = self._reader.feed(port.read(left_s), self._clock())
            for number, reply in enumerate(replies, 1):
                if reply.echo != command:
                    continue
                if reply.status not in good:
                    raise DeviceFault(f"the laser refuses {command} with {meaning(reply.status)}")
                self._early = replies[number:]
                return reply
        raise DeviceSilent(f"no answer to {command} from {self.url}: does this laser speak SCIP 2.0?")


def _tolerant(reply: ScipReply) -> dict[str, str]:
    """Return the description that a laser gives of itself; nothing if its form is not known."""
    with suppress(DamagedLine):
        return parameters(reply.lines)
    return {}
