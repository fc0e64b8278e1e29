"""SICK's LMS200, 211, 220, 221 and 291 on RS-232 or RS-422."""

import math
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.clock import RegularClock
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.laser import DeviceSweep, LaserGeometry
from robbie_robots.hw.pluggable_laser import PluggableLaser, ranges_in_metres
from robbie_robots.hw.sick.lms2xx_telegrams import (
    BIT_RATES,
    MODE_SWITCHED,
    PARTIAL_SCANS,
    POWER_ON,
    REFUSED,
    REQUEST_ONLY,
    SCAN,
    STREAM,
    SWITCH_MODE,
    SWITCH_VARIANT,
    VARIANT_SWITCHED,
    DamagedScan,
    Scan,
    TelegramFraming,
    complaint_of,
    least_code,
    scan,
    telegram,
)

MIRROR_TURNS_PER_S = 75.0
# Turns of the mirror for a scan, by the hundredths of a degree between beams.
TURNS = {100: 1, 50: 2, 25: 4}
FIELDS_DEG = (100, 180)
# The scanner answers within 60 ms, but for changes of mode and configuration.
ANSWER_S = 0.25
MODE_CHANGE_S = 3.0
CONFIGURATION_S = 7.0
ATTEMPTS = 2
BITS_PER_BYTE = 10
# Bytes of a scan's telegram without its values, which take two each.
FRAME_BYTES = 10


class SickLms2xx(PluggableLaser):
    """A laser that streams scans of 100 or 180 degrees.

    The driver finds the scanner's bit rate and switches it to `bit_rate`. Over half a degree, scans of four
    interlaced partial scans are put together.

    Args:
        url: "/dev/ttyUSB0": see `Port`.
        bit_rate: bit/s of the stream: 9,600, 19,200, 38,400 or 500,000. 38,400 carries half of the scans of
            180 degrees by 0.5; only 500,000 all of them.
        field_deg: 100 or 180.
        resolution_deg: 1, 0.5 or, with 100 degrees, 0.25.
        range_bits: 13 in the modes up to 8 m or 80 m, 14 up to 16 m or 160 m, 15 up to 32 m. The mode itself
            is the scanner's configuration, which the driver does not change.
        range_max_m: the longest range of the mode.
        latency_s: the shortest time from the last beam to the telegram's first bit, and from its last bit to
            its arrival. The driver knows the time of the scan and of the transmission.
        options: see `DeviceOptions`.

    Raises:
        ValueError: the scanner has no such bit rate, field or resolution.
    """

    def __init__(
        self,
        url: str,
        *,
        bit_rate: int = 38_400,
        field_deg: int = 180,
        resolution_deg: float = 0.5,
        range_bits: int = 13,
        range_max_m: float = 8.0,
        latency_s: float = 0.0,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self._field_deg, self._step = field_deg, round(100 * resolution_deg)
        if bit_rate not in BIT_RATES:
            raise ValueError(f"the scanner knows {', '.join(map(str, BIT_RATES))} bit/s, not {bit_rate}")
        if field_deg not in FIELDS_DEG or self._step not in TURNS:
            raise ValueError(f"the scanner has no field of {field_deg} degrees by {resolution_deg}")
        if self._step == min(TURNS) and field_deg != min(FIELDS_DEG):
            raise ValueError("the scanner measures every 0.25 degrees only in a field of 100 degrees")
        self._geometry = LaserGeometry(
            angle_min_rad=-math.radians(field_deg / 2),
            angle_increment_rad=math.radians(self._step / 100),
            beams=100 * field_deg // self._step + 1,
            range_min_m=0.01,
            range_max_m=range_max_m,
        )
        self.period_s = TURNS[self._step] / MIRROR_TURNS_PER_S
        # Interlaced beams are a turn apart; within a turn it is this.
        self.time_increment_s = self._step / 36_000 * self.period_s
        self._range_bits, self._found_rate = range_bits, 0
        self._stamps = self._scan_clock(latency_s)
        self._gaps = 0
        self._reader = FrameDecoder(TelegramFraming())
        self._early: list[bytes] = []
        self._parts: list[Scan] = []

    def _scan_clock(self, latency_s: float) -> RegularClock:
        """Return the clock that stamps the first beam of each sweep; set the period of the sweeps.

        The scanner transmits a scan as soon as its last beam is measured, and drops scans while its line is
        busy.
        """
        parts = PARTIAL_SCANS if self._step == min(TURNS) else 1
        sent_s = (FRAME_BYTES + 2 * (self.geometry.beams // parts)) * BITS_PER_BYTE / self.bit_rate
        measured_s = (TURNS[self._step] - 1 + self._field_deg / 360) / MIRROR_TURNS_PER_S
        # What a slow line does to parts is not known.
        periods = math.ceil(sent_s / self.period_s) if parts == 1 else 1
        clock = RegularClock(self.period_s, measured_s + sent_s + latency_s, periods)
        self.period_s *= periods
        return clock

    def _start(self, port: Port) -> None:
        """Find the bit rate, set field and resolution, and start the stream."""
        self._find(port)
        if self._found_rate != self.bit_rate:
            self._switch(port, bytes([BIT_RATES[self.bit_rate]]), MODE_CHANGE_S)
            port.set_bit_rate(self.bit_rate)
            self._found_rate = self.bit_rate
        variant = self._field_deg.to_bytes(2, "little") + self._step.to_bytes(2, "little")
        answer = self._ask(port, telegram(SWITCH_VARIANT, variant), VARIANT_SWITCHED, CONFIGURATION_S)
        if answer[5:6] != b"\x01":
            raise DeviceFault(f"the scanner refuses {self._field_deg} degrees by {self._step / 100:g}")
        self._switch(port, bytes([STREAM]), MODE_CHANGE_S)

    def _take(self, data: bytes) -> list[DeviceSweep]:
        """Return the scans that are whole now."""
        sweeps = []
        early, self._early = self._early, []
        for frame in [*early, *self._reader.feed(data)]:
            if frame[4] == POWER_ON:
                raise DeviceFault("the scanner was switched on again")
            if frame[4] == SCAN:
                try:
                    sweeps += self._sweeps(scan(frame, self._range_bits))
                except DamagedScan:
                    self._reader.damaged += 1
        self.counters.damaged, self.counters.skipped_bytes = self._reader.damaged, self._reader.skipped_bytes
        return sweeps

    def _reset(self) -> None:
        self._reader.reset()
        self._early.clear()
        self._stamps.forget()
        self._parts.clear()

    def _stop(self) -> None:
        """End the stream, and leave the bit rate that the scanner has after power-on."""
        self.port.write(telegram(SWITCH_MODE, bytes([REQUEST_ONLY])))

    def _sweeps(self, measured: Scan) -> list[DeviceSweep]:
        """Return the sweep that is whole with this scan, if one is."""
        arrived_s, geometry = self._clock(), self.geometry
        self.complaint = complaint_of(measured.status)
        if measured.partial is None:
            self._parts.clear()
            if len(measured.values) != geometry.beams:
                raise DamagedScan(f"{len(measured.values)} values instead of {geometry.beams}")
            return [self._sweep(measured.values, measured.unit_m, arrived_s)]
        if measured.partial != len(self._parts):
            self._parts.clear()  # one was lost
        if measured.partial == len(self._parts):
            self._parts.append(measured)
        if len(self._parts) < PARTIAL_SCANS:
            return []
        values = np.zeros(geometry.beams, np.int64)
        parts, self._parts = self._parts, []
        for offset, part in enumerate(parts):
            if len(part.values) != len(values[offset::PARTIAL_SCANS]):
                raise DamagedScan(f"{len(part.values)} values in a partial scan")
            values[offset::PARTIAL_SCANS] = part.values
        return [self._sweep(values, measured.unit_m, arrived_s)]

    def _sweep(self, values: NDArray[np.int64], unit_m: float, arrived_s: float) -> DeviceSweep:
        ranges = ranges_in_metres(values, unit_m, self.geometry)
        ranges[values >= least_code(self._range_bits)] = np.inf
        # ACK and NAK count as skipped, too, so that only damaged telegrams tell.
        has_gap, self._gaps = self._reader.damaged != self._gaps, self._reader.damaged
        return DeviceSweep(self._stamps.stamp_s(arrived_s, has_gap=has_gap), ranges)

    def _find(self, port: Port) -> None:
        """Find the scanner's bit rate and stop its stream."""
        for rate in sorted(BIT_RATES, key=lambda rate: (rate != self.bit_rate, rate)):
            port.set_bit_rate(rate)
            self._found_rate = rate
            with suppress(DeviceSilent):
                self._switch(port, bytes([REQUEST_ONLY]), ANSWER_S)
                return
        raise DeviceSilent(f"no SICK LMS2xx answers at {self.url}, at any bit rate")

    def _switch(self, port: Port, mode: bytes, limit_s: float) -> None:
        answer = self._ask(port, telegram(SWITCH_MODE, mode), MODE_SWITCHED, limit_s)
        if answer[5:6] != b"\x00":
            raise DeviceFault(f"the scanner refuses mode {mode.hex()} with {answer[5:6].hex()}")

    def _ask(self, port: Port, command: bytes, reply: int, limit_s: float) -> bytes:
        """Send a command, twice if need be, and return the scanner's answer to it.

        Raises:
            DeviceSilent: the scanner does not answer in time.
            DeviceFault: it refuses the command.
        """
        for _ in range(ATTEMPTS):
            port.write(command)
            end_s = monotonic() + limit_s / ATTEMPTS
            while (left_s := end_s - monotonic()) > 0:
                frames = self._reader.feed(port.read(left_s))
                for number, frame in enumerate(frames, 1):
                    if frame[4] == REFUSED:
                        raise DeviceFault(f"the scanner refuses the telegram {command.hex(' ')}")
                    if frame[4] == reply:
                        self._early = frames[number:]
                        return frame
        raise DeviceSilent(f"the scanner at {self.url} does not answer {command.hex(' ')}")
