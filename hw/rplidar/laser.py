"""Slamtec's RPLidar A and S series on a serial line."""

import math
import time
from collections.abc import Callable

import numpy as np

from hw.connection.clock import DeviceClock
from hw.connection.errors import DeviceFault, DeviceSilent
from hw.connection.port import Port
from hw.laser import LaserGeometry, LaserSweep
from hw.pluggable_laser import PluggableLaser, ranges_in_metres
from hw.pose import ORIGIN, Pose
from hw.rplidar.protocol import (
    CAPSULES,
    DESCRIPTOR_BYTES,
    EXPRESS_SCAN,
    GET_HEALTH,
    GET_INFO,
    GET_SAMPLE_TIMES,
    HEALTH,
    INFO,
    MOTOR_PWM,
    NODES,
    REPLY,
    RESET,
    SAMPLE_TIMES,
    SCAN,
    STOP,
    CapsuleReader,
    NodeReader,
    Sample,
    descriptor,
    request,
)

ANSWER_S = 0.5
# A stopped laser still sends what it has in its buffer.
QUIET_S = 0.02
BROKEN = 2
EXPRESS_LEGACY = bytes(5)
# A turn of more samples than this has lost its beginning.
MAX_SAMPLES = 8192
MAX_ANSWER_BYTES = 4096


class RpLidar(PluggableLaser):
    """A laser that streams turns of 360 degrees.

    It measures at uneven angles. The driver gives the nearest range of each of `beams` equal sectors.

    Args:
        url: "/dev/ttyUSB0": see `Port`.
        clock: returns the time for the stamps, s.
        bit_rate: bit/s: 115,200 for A1 and A2, 256,000 for A2M12, A3 and S1, 1,000,000 for S2 and S3.
        express: use the express mode, with more samples a second; not all models have it.
        beams: sectors of a turn.
        range_max_m: the longest range of the model.
        motor_pwm: speed of the motor, for models with an A2's motor control; None: leave it alone.
        silence_s: the laser counts as lost when it sends no whole turn for this time.
        mount: the laser's pose in the robot's frame.

    Attributes:
        identity: model, firmware, hardware and serial number, as the laser told them.
    """

    def __init__(
        self,
        url: str,
        clock: Callable[[], float] = time.time,
        *,
        bit_rate: int = 115_200,
        express: bool = False,
        beams: int = 720,
        range_max_m: float = 12.0,
        motor_pwm: int | None = 660,
        silence_s: float = 2.0,
        mount: Pose = ORIGIN,
    ) -> None:
        super().__init__(url, clock, bit_rate=bit_rate, silence_s=silence_s)
        self.identity = ""
        self._is_express, self._motor_pwm = express, motor_pwm
        self._geometry = LaserGeometry(
            angle_min_rad=-math.pi,
            angle_increment_rad=2 * math.pi / beams,
            beams=beams,
            range_min_m=0.05,
            range_max_m=range_max_m,
            mount=mount,
        )
        self._reader = CapsuleReader() if express else NodeReader()
        self._early = b""
        self._sample_s = 500e-6
        self._clock_of_samples = DeviceClock()
        self._counted = self._damaged = 0
        self._turn: list[Sample] | None = None
        self._turn_began_s = 0.0

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
        times = self._ask(port, GET_SAMPLE_TIMES, SAMPLE_TIMES, 4)
        microseconds = int.from_bytes(times[2:] if self._is_express else times[:2], "little")
        self._sample_s = (microseconds or 500) * 1e-6
        port.set_motor_line(False)
        if self._motor_pwm is not None:
            port.write(request(MOTOR_PWM, self._motor_pwm.to_bytes(2, "little")))
        if self._is_express:
            self._ask(port, EXPRESS_SCAN, CAPSULES, 0, EXPRESS_LEGACY)
        else:
            self._ask(port, SCAN, NODES, 0)

    def _take(self, data: bytes) -> list[LaserSweep]:
        """Return the turns that are whole now."""
        arrived_s = self._clock()
        early, self._early = self._early, b""
        samples = self._reader.feed(early + data)
        if self._reader.damaged != self._damaged:
            # An unknown number of samples is lost, so they no longer tell the time.
            self._damaged = self._reader.damaged
            self._turn = None
            self._clock_of_samples.forget()
        self.counters.damaged, self.counters.skipped_bytes = self._damaged, self._reader.skipped_bytes
        if not samples:
            return []
        self._counted += len(samples)
        last_s = self._clock_of_samples.stamp_s(self._counted * self._sample_s, arrived_s)
        sweeps = []
        for number, sample in enumerate(samples):
            if sample.is_first:
                if self._turn:
                    sweeps.append(self._sweep(self._turn))
                self._turn = []
                began_s = last_s - (len(samples) - number) * self._sample_s
                if sweeps or self.counters.values:
                    self.period_s = max(began_s - self._turn_began_s, 0.0)
                self._turn_began_s = began_s
            if self._turn is not None:
                self._turn.append(sample)
                if len(self._turn) > MAX_SAMPLES:
                    self._turn = None
        return sweeps

    def _reset(self) -> None:
        self._reader.forget()
        self._clock_of_samples.forget()
        self._early, self._turn = b"", None

    def _stop(self) -> None:
        """Stop the stream and the motor."""
        self.port.write(request(STOP))
        if self._motor_pwm is not None:
            self.port.write(request(MOTOR_PWM, bytes(2)))
        self.port.set_motor_line(True)

    def _sweep(self, turn: list[Sample]) -> LaserSweep:
        """Return the nearest range of each sector; the laser's angles are clockwise."""
        geometry = self.geometry
        told = np.array([(sample.angle_deg, sample.distance_mm, sample.quality) for sample in turn])
        metres = ranges_in_metres(told[:, 1], 0.001, geometry)
        turned = np.radians(-told[:, 0]) - geometry.angle_min_rad
        sectors = np.rint(turned / geometry.angle_increment_rad).astype(int) % geometry.beams
        ranges = np.full(geometry.beams, np.inf, np.float32)
        np.minimum.at(ranges, sectors, metres)
        intensities = None
        if not self._is_express:
            intensities = np.zeros(geometry.beams, np.float32)
            nearest = metres == ranges[sectors]
            intensities[sectors[nearest]] = told[nearest, 2]
        return LaserSweep(self._turn_began_s, ranges, intensities)

    def _ask(self, port: Port, command: int, kind: int, length: int, payload: bytes = b"") -> bytes:
        """Send a command and return the data of its answer; a stream's first bytes are kept.

        Raises:
            DeviceSilent: the laser does not answer in time.
        """
        port.write(request(command, payload))
        heard, end_s = b"", time.monotonic() + ANSWER_S
        while (left_s := end_s - time.monotonic()) > 0 and len(heard) < MAX_ANSWER_BYTES:
            heard += port.read(left_s)
            at = heard.find(REPLY)
            told = descriptor(heard[at : at + DESCRIPTOR_BYTES]) if at >= 0 else None
            if told is None or told.kind != kind or len(heard) < at + DESCRIPTOR_BYTES + length:
                continue
            self._early = heard[at + DESCRIPTOR_BYTES + length :]
            return heard[at + DESCRIPTOR_BYTES : at + DESCRIPTOR_BYTES + length]
        raise DeviceSilent(
            f"the laser at {self.url} does not answer command {command:#04x}: is it an RPLidar?"
        )
