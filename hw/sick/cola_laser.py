"""SICK's TiM3xx, 5xx, 7xx, LMS1xx and LMS5xx lasers over TCP."""

import math

import numpy as np
from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.clock import DeviceClock
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.laser import DeviceSweep, LaserGeometry
from robbie_robots.hw.pluggable_laser import PluggableLaser, ranges_in_metres
from robbie_robots.hw.sick.cola import (
    CONFIGURE,
    END_STREAM,
    LOG_IN,
    RUN,
    SCAN,
    START_MEASURING,
    STREAM,
    BinaryFraming,
    ColaCommand,
    DamagedTelegram,
    Dialect,
    ScanData,
    TextReader,
    scan_data,
)

ANSWER_S = 1.0
# 32 bits of microseconds.
CLOCK_WRAPS_S = 2**32 / 1e6
AHEAD_DEG = 90.0
# Bits of the device status.
POLLUTION_WARNING, POLLUTION_ERROR = 2, 4


class SickColaLaser(PluggableLaser):
    """A laser that streams scans.

    Args:
        url: "socket://192.168.0.1:2112": see `Port`. Many lasers speak B at port 2112 and A at port 2111.
        dialect: what the laser speaks at that port.
        intensities: have the laser send intensities, too; this changes its configuration until it is switched
            off. Without, it sends what it is configured to.
        range_max_m: the longest range of the model: 10 to 25 for a TiM, 20 for an LMS1xx, 80 for an LMS5xx.
        latency_s: the shortest time between the transmission of a scan, by the laser's clock, and its
            arrival.
        options: see `DeviceOptions`.

    Attributes:
        serial_number: the laser's; 0 before the first scan.
    """

    def __init__(
        self,
        url: str,
        *,
        dialect: Dialect = Dialect.B,
        intensities: bool = False,
        range_max_m: float = 25.0,
        latency_s: float = 0.0,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, **options)
        self.serial_number = 0
        self._dialect, self._intensities = dialect, intensities
        self._range_max_m = range_max_m
        self._stamps = DeviceClock(CLOCK_WRAPS_S, 1e-6, latency_s)
        self._reader = TextReader() if dialect is Dialect.A else FrameDecoder(BinaryFraming())
        self._early: list[bytes] = []

    def _start(self, port: Port) -> None:
        """Configure the laser if need be, and start the stream."""
        if self._intensities:
            for command in (LOG_IN, CONFIGURE, START_MEASURING, RUN):
                self._ask(port, command)
        self._ask(port, STREAM)

    def _take(self, data: bytes) -> list[DeviceSweep]:
        """Return the scans that are whole now."""
        arrived_s, sweeps = self._clock(), []
        early, self._early = self._early, []
        for payload in [*early, *self._reader.feed(data)]:
            verb, _, rest = payload.partition(b" ")
            if verb != b"sSN" or not rest.startswith(SCAN):
                continue
            try:
                sweeps.append(self._sweep(scan_data(payload, self._dialect), arrived_s))
            except DamagedTelegram:
                self._reader.damaged += 1
        self.counters.damaged, self.counters.skipped_bytes = self._reader.damaged, self._reader.skipped_bytes
        return sweeps

    def _reset(self) -> None:
        self._reader.reset()
        self._early.clear()
        self._stamps.forget()

    def _stop(self) -> None:
        """End the stream."""
        self.port.write(END_STREAM.frame(self._dialect))

    def _sweep(self, scan: ScanData, arrived_s: float) -> DeviceSweep:
        channels = {channel.name: channel for channel in scan.channels}
        distances, strengths = channels.get("DIST1"), channels.get("RSSI1")
        if distances is None or not len(distances.values) or not distances.step_1e4_deg:
            raise DamagedTelegram("a scan without distances")
        if not (math.isfinite(distances.scale) and math.isfinite(distances.offset)):
            raise DamagedTelegram("distances without a scale")
        step_rad = math.radians(distances.step_1e4_deg / 1e4)
        geometry = LaserGeometry(
            angle_min_rad=math.radians(distances.start_1e4_deg / 1e4 - AHEAD_DEG),
            angle_increment_rad=step_rad,
            beams=len(distances.values),
            # In place of a range, 0 means none, and small numbers are error codes.
            range_min_m=0.05,
            range_max_m=self._range_max_m,
        )
        sent_s = self._stamps.stamp_s(scan.sent_us / 1e6, arrived_s)
        self._geometry, self.serial_number = geometry, scan.serial_number
        self.complaint = complaint_of(scan.status)
        if scan.scan_rate_hz:
            self.period_s = 1 / scan.scan_rate_hz
            self.time_increment_s = self.period_s * step_rad / (2 * math.pi)
        millimetres = distances.values.astype(np.float64) * distances.scale + distances.offset
        intensities = None
        if strengths is not None and len(strengths.values) == geometry.beams:
            intensities = (strengths.values * strengths.scale + strengths.offset).astype(np.float32)
        stamp_s = sent_s - self._age_s(scan, geometry)
        return DeviceSweep(stamp_s, ranges_in_metres(millimetres, 0.001, geometry), intensities)

    def _age_s(self, scan: ScanData, geometry: LaserGeometry) -> float:
        """Return how long before its transmission a scan's first beam was measured.

        What a laser calls the time of a scan differs: an LMS1xx or LMS5xx tells when the scan began, a TiM
        when it ended. A scan that was sent sooner than it takes to measure has reported its end.
        """
        told_s = (scan.sent_us - scan.start_us) % 2**32 / 1e6
        field_s = (geometry.beams - 1) * self.time_increment_s
        return told_s + field_s if told_s < field_s else told_s

    def _ask(self, port: Port, command: ColaCommand) -> None:
        """Send a command and wait for the laser's answer.

        Raises:
            DeviceSilent: the laser does not answer in time.
            DeviceFault: it answers with an error.
        """
        port.write(command.frame(self._dialect))
        end_s = monotonic() + ANSWER_S
        while (left_s := end_s - monotonic()) > 0:
            payloads = self._reader.feed(port.read(left_s))
            for number, payload in enumerate(payloads, 1):
                if payload.startswith(b"sFA"):
                    raise DeviceFault(f"the laser answers {command.name} with the error {payload[4:]!r}")
                if payload.startswith(command.answer.encode()):
                    self._early = payloads[number:]
                    return
        raise DeviceSilent(
            f"the laser at {self.url} does not answer {command.name}: is it CoLa {self._dialect}?"
        )


def complaint_of(status: int) -> str:
    """Return what a scan's device status means, in plain words; '' for 0."""
    if status & POLLUTION_ERROR:
        return "the laser reports that its front screen is too dirty to measure: clean it"
    if status & POLLUTION_WARNING:
        return "the laser reports that its front screen is dirty: clean it"
    return f"the laser reports an error (device status {status})" if status else ""
