"""Slamtec's RPLidar A and S series on a serial line."""

import math
import struct
from contextlib import suppress
from dataclasses import replace

import numpy as np
from strenum import StrEnum
from typing_extensions import Unpack

from robbie_robots.hw.connection.clock import MAX_DRIFT, RegularClock
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.laser import DeviceSweep, LaserGeometry
from robbie_robots.hw.pluggable_laser import PluggableLaser, ranges_in_metres
from robbie_robots.hw.rplidar.protocol import (
    CAPSULES,
    CONFIGURATION,
    DENSE_CAPSULES,
    DESCRIPTOR_BYTES,
    EXPRESS_SCAN,
    GET_CONFIGURATION,
    GET_HEALTH,
    GET_INFO,
    GET_SAMPLE_TIMES,
    HEALTH,
    HQ_CAPSULES,
    INFO,
    MODE_ANSWER,
    MODE_COUNT,
    MODE_NAME,
    MODE_SAMPLE_TIME,
    MOTOR_PWM,
    NODES,
    REPLY,
    RESET,
    SAMPLE_TIME_UNIT_S,
    SAMPLE_TIMES,
    SCAN,
    STOP,
    TYPICAL_MODE,
    ULTRA_CAPSULES,
    ScanMode,
    descriptor,
    request,
)
from robbie_robots.hw.rplidar.streams import READERS, NodeReader, Samples, StreamReader, joined

ANSWER_S = 0.5
# A stopped laser still sends what it has in its buffer.
QUIET_S = 0.02
BROKEN = 2
# A turn of more samples than this has lost its beginning.
MAX_SAMPLES = 8192
MAX_ANSWER_BYTES = 4096
MAX_MODES = 16
# Older lasers tell the time between samples in whole microseconds.
ROUNDING_S = 0.5e-6
MAX_ROUGH_SAMPLE_S = 120e-6
BITS_PER_BYTE = 10
# Frames of about this time are read and decoded together: each batch has a price of its own.
BATCH_S = 0.016
# Of these, the last ones are read as they arrive: more than the jitter of a line.
LAST_FRAMES_S = 0.002


class Mode(StrEnum):
    """What every driver knows of scan modes; lasers have their own names besides."""

    STANDARD = "standard"
    """Each sample alone: all models have it, with the fewest samples a second."""

    TYPICAL = "typical"
    """The one that the laser recommends."""

    EXPRESS = "express"
    ULTRA = "ultra"
    DENSE = "dense"
    HQ = "hq"


# The quickest mode with this kind of stream is meant.
ANSWERS = {
    Mode.EXPRESS: CAPSULES,
    Mode.ULTRA: ULTRA_CAPSULES,
    Mode.DENSE: DENSE_CAPSULES,
    Mode.HQ: HQ_CAPSULES,
}


class RpLidar(PluggableLaser):
    """A laser that streams turns of 360 degrees.

    It measures at uneven angles. The driver gives the nearest range of each of `beams` equal sectors.

    Args:
        url: "/dev/ttyUSB0": see `Port`.
        bit_rate: bit/s: 115,200 for A1 and A2, 256,000 for A2M12, A3 and S1, 1,000,000 for S2 and S3.
        mode: how to measure: "standard", "typical", "express", "ultra", "dense", "hq", or a name that the
            laser itself has for a mode, such as "Boost" or "Sensitivity".
        beams: sectors of a turn.
        range_max_m: the longest range of the model.
        motor_pwm: speed of the motor, for models with an A2's motor control; None: leave it alone.
        options: see `DeviceOptions`.

    Attributes:
        identity: model, firmware, hardware and serial number, as the laser told them.
        scan_mode: the mode that runs; None before it is known.
    """

    SILENCE_S = 2.0

    def __init__(
        self,
        url: str,
        *,
        bit_rate: int = 115_200,
        mode: str = Mode.STANDARD,
        beams: int = 720,
        range_max_m: float = 12.0,
        motor_pwm: int | None = 660,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self.identity = ""
        self.scan_mode: ScanMode | None = None
        self._mode, self._motor_pwm = mode, motor_pwm
        self._geometry = LaserGeometry(
            angle_min_rad=-math.pi,
            angle_increment_rad=2 * math.pi / beams,
            beams=beams,
            range_min_m=0.05,
            range_max_m=range_max_m,
        )
        self._waiting = b""
        self._batch_began_s = math.inf
        self._turn: list[Samples] | None = None
        self._turn_began_s = 0.0
        self._use(NodeReader(), 500e-6, MAX_DRIFT)

    def _start(self, port: Port) -> None:
        """Stop what runs, ask who the laser is, switch its motor on, and start the stream."""
        port.write(request(STOP))
        port.drain(QUIET_S, ANSWER_S)
        info = self._ask(port, GET_INFO, INFO, 20)
        self.identity = (
            f"model {info[0]:#x}, firmware {info[2]}.{info[1]:02x}, hardware {info[3]}, {info[4:].hex()}"
        )
        health = self._ask(port, GET_HEALTH, HEALTH, 3)
        if health[0] == BROKEN:
            port.write(request(RESET))
            raise DeviceFault(f"the laser reports the error {int.from_bytes(health[1:], 'little'):#06x}")
        self.scan_mode = mode = self._chosen(port)
        is_rough = mode.sample_s % 1e-6 < 1e-9
        drift = MAX_DRIFT + (ROUNDING_S / mode.sample_s if is_rough else 0.0)
        self._use(READERS[mode.answer](), mode.sample_s, drift)
        port.set_motor_line(False)
        if self._motor_pwm is not None:
            port.write(request(MOTOR_PWM, self._motor_pwm.to_bytes(2, "little")))
        if mode.answer == NODES:
            self._ask(port, SCAN, NODES, 0)
        else:
            self._ask(port, EXPRESS_SCAN, mode.answer, 0, bytes([mode.number]) + bytes(4))

    def _use(self, reader: StreamReader, sample_s: float, drift: float) -> None:
        """Get ready for a stream."""
        self._reader, self._sample_s = reader, sample_s
        self._frames = self._gaps = 0
        self._frame_s = frame_s = reader.frame_samples * sample_s
        frames = max(1, round(BATCH_S / frame_s))
        self._batch_bytes = reader.frame_bytes * frames
        # The last frames of a batch are read as they arrive, so that the stamp is right.
        self.gather_s = self._full_gather_s = max(frames * frame_s - max(frame_s, LAST_FRAMES_S), 0.0)
        sent_s = 0.0
        if not self.url.startswith("socket://"):
            sent_s = reader.frame_bytes * BITS_PER_BYTE / self.bit_rate
        self._clock_of_frames = RegularClock(frame_s, sent_s, max_drift=drift)

    def _take(self, data: bytes) -> list[DeviceSweep]:
        """Return the turns that are whole now."""
        arrived_s, reader = self._clock(), self._reader
        self._waiting += data
        # The least late read of a batch tells when its last frame arrived.
        batch_s = (reader.buffered_bytes + len(self._waiting)) // reader.frame_bytes * self._frame_s
        if data:
            self._batch_began_s = min(self._batch_began_s, arrived_s - batch_s)
            if len(self._waiting) < self._batch_bytes:
                self.gather_s = 0.0
                return []
        arrived_s = min(arrived_s, self._batch_began_s + batch_s)
        self.gather_s, self._batch_began_s = self._full_gather_s, math.inf
        waiting, self._waiting = self._waiting, b""
        samples = reader.feed(waiting)
        self.counters.damaged, self.counters.skipped_bytes = reader.damaged, reader.skipped_bytes
        frames, self._frames = reader.frames - self._frames, reader.frames
        if not frames:
            return []
        has_gap, self._gaps = reader.gaps != self._gaps, reader.gaps
        if has_gap:
            self._turn = None
        last_s = self._clock_of_frames.stamp_s(arrived_s, frames, has_gap)
        # When the first of the samples was measured: others are behind it, also those not yet known.
        first_s = last_s - (len(samples) + reader.pending - 1) * self._sample_s
        return self._turns(samples, first_s)

    def _turns(self, samples: Samples, first_s: float) -> list[DeviceSweep]:
        """Return the turns that end within some samples; keep the last one's beginning."""
        sweeps, begin = [], 0
        for at in np.flatnonzero(samples.firsts).tolist():
            if self._turn is not None:
                self._turn.append(samples.part(begin, at))
                if turn := joined(self._turn):
                    sweeps.append(self._sweep(turn))
            began_s = first_s + at * self._sample_s
            if sweeps or self.counters.values:
                self.period_s = max(began_s - self._turn_began_s, 0.0)
            self._turn, self._turn_began_s, begin = [], began_s, at
        if self._turn is not None:
            self._turn.append(samples.part(begin, len(samples)))
            if sum(map(len, self._turn)) > MAX_SAMPLES:
                self._turn = None
        return sweeps

    def _reset(self) -> None:
        self._reader.forget()
        self._clock_of_frames.forget()
        self._waiting, self._turn, self._batch_began_s = b"", None, math.inf

    def _stop(self) -> None:
        """Stop the stream and the motor."""
        self.port.write(request(STOP))
        if self._motor_pwm is not None:
            self.port.write(request(MOTOR_PWM, bytes(2)))
        self.port.set_motor_line(True)

    def _sweep(self, turn: Samples) -> DeviceSweep:
        """Return the nearest range of each sector; the laser's angles are clockwise."""
        geometry = self.geometry
        metres = ranges_in_metres(turn.distances_mm, 0.001, geometry)
        turned = np.radians(-turn.angles_deg) - geometry.angle_min_rad
        sectors = np.rint(turned / geometry.angle_increment_rad).astype(np.int64) % geometry.beams
        ranges = np.full(geometry.beams, np.inf, np.float32)
        np.minimum.at(ranges, sectors, metres)
        intensities = None
        if turn.qualities is not None:
            intensities = np.zeros(geometry.beams, np.float32)
            nearest = metres == ranges[sectors]
            intensities[sectors[nearest]] = turn.qualities[nearest]
        return DeviceSweep(self._turn_began_s, ranges, intensities)

    def _chosen(self, port: Port) -> ScanMode:
        """Return the scan mode to use.

        Raises:
            DeviceFault: the laser has no such mode.
        """
        times = struct.unpack("<HH", self._ask(port, GET_SAMPLE_TIMES, SAMPLE_TIMES, 4))
        standard = ScanMode(0, "Standard", NODES, (times[0] or 500) * 1e-6)
        if self._mode == Mode.STANDARD:
            return self._precise(port, standard)
        try:
            modes, typical = self._modes(port)
        except DeviceSilent:
            # Firmware before 1.24 knows only one other mode.
            modes, typical = [ScanMode(0, "Express", CAPSULES, (times[1] or 250) * 1e-6)], 0
        if self._mode == Mode.TYPICAL:
            fitting = [mode for mode in modes if mode.number == typical]
        elif self._mode in ANSWERS:
            fitting = [mode for mode in modes if mode.answer == ANSWERS[Mode(self._mode)]]
        else:
            fitting = [mode for mode in modes if mode.name.lower() == self._mode.lower()]
        fitting = [mode for mode in fitting if mode.answer in READERS and mode.sample_s > 0]
        if not fitting:
            known = ", ".join(f"{mode.name} ({mode.answer:#x})" for mode in [standard, *modes])
            raise DeviceFault(f"the laser has no scan mode {self._mode!r} that can be read; it has {known}")
        return min(fitting, key=lambda mode: mode.sample_s)

    def _precise(self, port: Port, standard: ScanMode) -> ScanMode:
        """Return the standard mode, with a better sample time if it is too short for whole microseconds."""
        if standard.sample_s > MAX_ROUGH_SAMPLE_S:
            return standard
        with suppress(DeviceSilent):
            told = int.from_bytes(self._configuration(port, MODE_SAMPLE_TIME, standard.number), "little")
            return replace(standard, sample_s=told * SAMPLE_TIME_UNIT_S or standard.sample_s)
        return standard

    def _modes(self, port: Port) -> tuple[list[ScanMode], int]:
        """Return the scan modes that the laser tells, and the number of the one that it recommends."""
        count = min(int.from_bytes(self._configuration(port, MODE_COUNT), "little"), MAX_MODES)
        modes = [
            ScanMode(
                number,
                self._configuration(port, MODE_NAME, number).split(b"\0")[0].decode("ascii", "replace"),
                int.from_bytes(self._configuration(port, MODE_ANSWER, number)[:1], "little"),
                int.from_bytes(self._configuration(port, MODE_SAMPLE_TIME, number), "little")
                * SAMPLE_TIME_UNIT_S,
            )
            for number in range(count)
        ]
        return modes, int.from_bytes(self._configuration(port, TYPICAL_MODE), "little")

    def _configuration(self, port: Port, kind: int, mode: int | None = None) -> bytes:
        """Return what the laser tells of one kind, without the kind itself."""
        payload = kind.to_bytes(4, "little") + (b"" if mode is None else mode.to_bytes(2, "little"))
        return self._ask(port, GET_CONFIGURATION, CONFIGURATION, None, payload)[4:]

    def _ask(self, port: Port, command: int, kind: int, length: int | None, payload: bytes = b"") -> bytes:
        """Send a command and return the data of its answer; a stream's first bytes are kept.

        Args:
            port: the open port.
            command: the command.
            kind: of the answer.
            length: of its data; None: as the answer tells.
            payload: of the command.

        Raises:
            DeviceSilent: the laser does not answer in time.
        """
        port.write(request(command, payload))
        heard, end_s = b"", self._monotonic() + ANSWER_S
        while (left_s := end_s - self._monotonic()) > 0 and len(heard) < MAX_ANSWER_BYTES:
            heard += port.read(left_s)
            at = heard.find(REPLY)
            told = descriptor(heard[at : at + DESCRIPTOR_BYTES]) if at >= 0 else None
            if told is None or told.kind != kind:
                continue
            begin = at + DESCRIPTOR_BYTES
            end = begin + (told.length if length is None else length)
            if len(heard) >= end:
                self._waiting = heard[end:]
                return heard[begin:end]
        raise DeviceSilent(
            f"the laser at {self.url} does not answer command {command:#04x}: is it an RPLidar?"
        )
