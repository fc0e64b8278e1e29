"""Xsens MTi units on a serial line or USB, newer ones (`MTData2`) and older ones (`MTData`)."""

from typing import NamedTuple

import numpy as np
from typing_extensions import Unpack

from robbie_robots.hw.connection.clock import DeviceClock
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.imu import ImuSample, OrientedSample, gathered_s
from robbie_robots.hw.xsens import xbus
from robbie_robots.hw.xsens.xbus import MessageId, OutputMode, OutputSettings, XbusData, XbusMessage

BIT_RATE = 115_200
# The unit's clock: ticks of 0.1 ms in 32 bits.
CLOCK_WRAPS_AT_S = 2**32 / 10_000
ANSWER_TIMEOUT_S = 1.0
OLD_MODE = OutputMode.CALIBRATED | OutputMode.ORIENTATION
OLD_SETTINGS = OutputSettings.SAMPLE_COUNTER
# Counter and clock come with every message; the rate FFFF says so.
WITH_EVERY_MESSAGE = 0xFFFF


class _Refused(NamedTuple):
    code: int


class XsensImu(PluggableDevice[OrientedSample]):
    """An MTi. Stamps come from the unit's own clock, if it tells it.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        rate_hz: samples in each second; older units keep their own rate.
        bit_rate: bit/s.
        options: see `DeviceOptions`.
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
        self.gather_s = gathered_s(rate_hz)
        self._decoder = FrameDecoder(xbus.XbusFraming())
        self._unreadable = 0
        self._old = xbus.OldData(OLD_MODE, OLD_SETTINGS)
        self._device_clock = DeviceClock(wraps_at_s=CLOCK_WRAPS_AT_S, resolution_s=1e-4)

    def _start(self, port: Port) -> None:
        decoder = FrameDecoder(xbus.XbusFraming())
        self._ask(port, decoder, MessageId.GO_TO_CONFIG)
        outputs = [(identifier, self.rate_hz) for identifier in (0x2010, 0x4020, 0x8020)]
        outputs[:0] = [(0x1020, WITH_EVERY_MESSAGE), (0x1060, WITH_EVERY_MESSAGE)]
        wanted = decoder.framing.parse(xbus.output_configuration(outputs))
        answer = self._answer(port, decoder, wanted)
        if isinstance(answer, _Refused):
            # An older unit does not know this message.
            for message in (xbus.output_mode(OLD_MODE), xbus.output_settings(OLD_SETTINGS)):
                self._ask(port, decoder, *decoder.framing.parse(message))
        self._ask(port, decoder, MessageId.GO_TO_MEASUREMENT)

    def _ask(self, port: Port, decoder: FrameDecoder[XbusMessage], number: int, data: bytes = b"") -> None:
        answer = self._answer(port, decoder, XbusMessage(number, data))
        if isinstance(answer, _Refused):
            raise DeviceFault(
                f"the unit at {self.url} refuses message {number:02X} with error {answer.code:02X}"
            )

    def _answer(
        self, port: Port, decoder: FrameDecoder[XbusMessage], asked: XbusMessage
    ) -> XbusMessage | _Refused:
        """Send a message and return its answer; measurements of an earlier stream may come before it."""
        port.write(xbus.message(*asked))
        end_s = self._monotonic() + ANSWER_TIMEOUT_S
        while (left_s := end_s - self._monotonic()) > 0:
            for message in decoder.feed(port.read(left_s)):
                if message.number == asked.number + 1:
                    return message
                if message.number == MessageId.ERROR:
                    return _Refused(message.data[0] if message.data else 0)
        raise DeviceSilent(f"no MTi answers message {asked.number:02X} at {self.url}")

    def _reset(self) -> None:
        self._decoder.reset()
        self._device_clock.forget()

    def _stop(self) -> None:
        self.send(xbus.message(MessageId.GO_TO_CONFIG))

    def _take(self, data: bytes) -> list[OrientedSample]:
        arrived_s = self._clock()
        samples = []
        for message in self._decoder.feed(data):
            try:
                sample = self._sample(message, arrived_s)
            except DamagedFrame:
                self._unreadable += 1
                continue
            if sample is not None:
                samples.append(sample)
        self.counters.damaged = self._decoder.damaged + self._unreadable
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return samples

    def _sample(self, message: XbusMessage, arrived_s: float) -> OrientedSample | None:
        if message.number == MessageId.DATA2:
            told = xbus.data2(message)
        elif message.number == MessageId.DATA:
            told = self._old.read(message)
        else:
            return None
        if told.turn_rad_per_s is None or told.acceleration_m_per_s2 is None:
            raise DamagedFrame("it tells no turn rates or no acceleration")
        quaternion = None if told.quaternion is None else np.array(told.quaternion)
        turn, acceleration = np.array(told.turn_rad_per_s), np.array(told.acceleration_m_per_s2)
        return OrientedSample(ImuSample(self._stamp_s(told, arrived_s), turn, acceleration), quaternion)

    def _stamp_s(self, told: XbusData, arrived_s: float) -> float:
        if told.sample_time_s is None:
            return arrived_s
        return self._device_clock.stamp_s(told.sample_time_s, arrived_s)
