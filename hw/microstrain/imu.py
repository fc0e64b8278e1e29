"""MicroStrain units with MIP on a serial line or USB, such as the 3DM-GX5 and 3DM-CV5.

Source: LORD MicroStrain, 3DM-GX5-25 Data Communications Protocol.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Unpack

from robbie_robots.hw.connection.clock import DeviceClock
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.imu import ImuSample, OrientedSample, gathered_s
from robbie_robots.hw.microstrain import mip
from robbie_robots.hw.microstrain.mip import STANDARD_GRAVITY_M_PER_S2 as ONE_G
from robbie_robots.hw.microstrain.mip import MipFraming, MipPacket, SensorField

BIT_RATE = 115_200
ANSWER_S = 0.3
ATTEMPTS = 3
WEEK_S = 7 * 86_400.0
REQUIRED = (SensorField.ACCELERATION, SensorField.TURN_RATE)
# Not every model has these: of each row the unit sends the first that it knows.
WELCOME = ((SensorField.QUATERNION,), (SensorField.REFERENCE_TIME, SensorField.GPS_TIME))
# From the unit's axes (ahead, right, down) to those of REP 103 (ahead, left, up), and back.
AXES = np.array([1.0, -1.0, -1.0])
HALF = math.sqrt(0.5)


class MicroStrainImu(PluggableDevice[OrientedSample]):
    """A unit with MIP. Stamps come from the unit's own clock, if it tells it.

    Its quaternion comes from the unit's own filter. In the world's frame x points east and y north.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        rate_hz: samples in each second; the unit divides its own rate by a whole number.
        bit_rate: bit/s.
        options: see `DeviceOptions`.

    Example:
        with closing(MicroStrainImu("/dev/ttyACM0", rate_hz=200)) as imu:
            for oriented in imu.poll(0.1):
                print(oriented.sample.turn_rad_per_s)
    """

    SILENCE_S = 0.5

    def __init__(
        self,
        url: str,
        rate_hz: int = 100,
        bit_rate: int = BIT_RATE,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self.rate_hz = rate_hz
        self.fields: tuple[SensorField, ...] = ()
        """What the unit sends."""
        self._decoder = FrameDecoder(MipFraming())
        self._unreadable = 0
        self._reference_clock = DeviceClock(resolution_s=1e-9)
        self._gps_clock = DeviceClock(wraps_at_s=WEEK_S)

    def _start(self, port: Port) -> None:
        decoder = FrameDecoder(MipFraming())
        self._ask(port, decoder, mip.set_idle())
        base_hz = mip.base_rate_hz(self._ask(port, decoder, mip.base_rate_question()))
        if not base_hz:
            raise DeviceFault(f"the unit at {self.url} does not tell how often it measures")
        divisor = max(1, round(base_hz / self.rate_hz))
        fields = list(REQUIRED)
        for row in WELCOME:
            for field in row:
                if not self._refusal(self._answer(port, decoder, _format([*fields, field], divisor))):
                    fields.append(field)
                    break
        for request in (_format(fields, divisor), mip.enable_sensor_stream(), mip.resume()):
            self._ask(port, decoder, request)
        self.fields = tuple(fields)
        self.gather_s = gathered_s(base_hz / divisor)

    def _ask(self, port: Port, decoder: FrameDecoder[MipPacket], request: bytes) -> MipPacket:
        answer = self._answer(port, decoder, request)
        if error := self._refusal(answer):
            command = mip.replies(answer)[0].command
            raise DeviceFault(
                f"the unit at {self.url} refuses command {answer.descriptor_set:02X} {command:02X} "
                f"with error {error}"
            )
        return answer

    @staticmethod
    def _refusal(answer: MipPacket) -> int:
        return mip.replies(answer)[0].error

    def _answer(self, port: Port, decoder: FrameDecoder[MipPacket], request: bytes) -> MipPacket:
        """Send a command and return its answer; measurements of an earlier stream may come before it."""
        asked = decoder.framing.parse(request)
        command = asked.fields[0].descriptor
        for _ in range(ATTEMPTS):
            port.write(request)
            end_s = self._monotonic() + ANSWER_S
            while (left_s := end_s - self._monotonic()) > 0:
                for packet in decoder.feed(port.read(left_s)):
                    commands = [reply.command for reply in mip.replies(packet)]
                    if packet.descriptor_set == asked.descriptor_set and command in commands[:1]:
                        return packet
        raise DeviceSilent(
            f"no unit with MIP answers command {asked.descriptor_set:02X} {command:02X} at {self.url}"
        )

    def _reset(self) -> None:
        self._decoder.reset()
        self._reference_clock.forget()
        self._gps_clock.forget()

    def _stop(self) -> None:
        self.send(mip.set_idle())

    def _take(self, data: bytes) -> list[OrientedSample]:
        arrived_s = self._clock()
        samples = []
        for packet in self._decoder.feed(data):
            try:
                values = mip.sensor_values(packet)
            except DamagedFrame:
                self._unreadable += 1
                continue
            if all(field in values for field in REQUIRED):
                samples.append(self._sample(values, arrived_s))
            elif packet.descriptor_set == mip.DescriptorSet.SENSOR_DATA:
                self._unreadable += 1
        self.counters.damaged = self._decoder.damaged + self._unreadable
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return samples

    def _sample(self, values: dict[SensorField, tuple[float, ...]], arrived_s: float) -> OrientedSample:
        # Hundreds of times a second: as numbers of Python's this takes half as long as with arrays.
        turn_x, turn_y, turn_z = values[SensorField.TURN_RATE]
        ahead, right, down = values[SensorField.ACCELERATION]
        turn = np.array((turn_x, -turn_y, -turn_z))
        acceleration = np.array((ahead * ONE_G, -right * ONE_G, -down * ONE_G))
        told = values.get(SensorField.QUATERNION)
        quaternion = None if told is None else with_z_up(told)
        return OrientedSample(ImuSample(self._stamp_s(values, arrived_s), turn, acceleration), quaternion)

    def _stamp_s(self, values: dict[SensorField, tuple[float, ...]], arrived_s: float) -> float:
        if told := values.get(SensorField.REFERENCE_TIME):
            return self._reference_clock.stamp_s(told[0] * 1e-9, arrived_s)
        if (told := values.get(SensorField.GPS_TIME)) and 0 <= told[0] <= WEEK_S:
            return self._gps_clock.stamp_s(told[0], arrived_s)
        return arrived_s


def with_z_up(quaternion: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert an orientation between MicroStrain's frames and those of REP 103, either way.

    MicroStrain turns (ahead, right, down) to (north, east, down); REP 103 turns (ahead, left, up) to
    (east, north, up).

    Args:
        quaternion: w, x, y, z.

    Returns:
        (4,): w, x, y, z.

    Example:
        A level unit that looks north: `with_z_up((1, 0, 0, 0))` is a turn by 90 degrees to the left of east.
    """
    w, x, y, z = quaternion
    # Half a turn about the line between north and east, and half a turn about the unit's x.
    return np.array(((w + z) * HALF, (x + y) * HALF, (x - y) * HALF, (w - z) * HALF))


def _format(fields: Sequence[SensorField], divisor: int) -> bytes:
    return mip.sensor_format([(field, divisor) for field in fields])
