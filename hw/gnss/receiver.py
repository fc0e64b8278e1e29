"""Receivers of satellite navigation systems on a serial line or USB: any by NMEA 0183, u-blox by UBX."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Generic

from typing_extensions import Unpack

from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import DamagedFrame, Frame, FrameDecoder, Framing
from robbie_robots.hw.gnss import nmea, ubx

NMEA_BIT_RATE = 4_800
UBX_BIT_RATE = 9_600
# A receiver under the open sky is off by about this for each unit of dilution of precision.
M_PER_DILUTION = 3.0


@dataclass(frozen=True)
class SatellitePosition:
    """Where the antenna is; a value that the receiver does not know is NaN.

    Attributes:
        stamp_s: time of arrival.
        has_fix: whether satellites gave the position now; one that was estimated, typed in or simulated is no
            fix.
        is_corrected: whether corrections of a reference station, also by satellite, are in it.
        latitude_deg: WGS 84, positive to the north.
        longitude_deg: WGS 84, positive to the east.
        height_m: above the ellipsoid.
        horizontal_m: standard deviation, estimated.
        vertical_m: standard deviation, estimated.
        satellites: number of satellites used.
    """

    stamp_s: float
    has_fix: bool
    is_corrected: bool
    latitude_deg: float
    longitude_deg: float
    height_m: float
    horizontal_m: float
    vertical_m: float
    satellites: int


class Receiver(PluggableDevice[SatellitePosition], Generic[Frame]):
    """Base of receivers. An old position is published as old, never repeated as new.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        bit_rate: bit/s.
        framing: of the receiver's protocol.
        options: see `DeviceOptions`.
    """

    SILENCE_S = 3.0

    def __init__(
        self,
        url: str,
        bit_rate: int,
        framing: Framing[Frame],
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self._decoder = FrameDecoder(framing)
        self._unreadable = 0
        self._heard = False

    @abstractmethod
    def _position(self, frame: Frame, stamp_s: float) -> SatellitePosition | None:
        """Return the position that a frame tells; None: it tells something else."""

    def _start(self, port: Port) -> None:
        """Wait for nothing: a receiver sends by itself, and counts as lost when nothing valid comes."""

    def _reset(self) -> None:
        self._decoder.reset()

    def _take(self, data: bytes) -> list[SatellitePosition]:
        stamp_s = self._clock()
        positions = []
        for frame in self._decoder.feed(data):
            self._heard = True
            try:
                position = self._position(frame, stamp_s)
            except DamagedFrame:
                self._unreadable += 1
                continue
            if position is not None:
                positions.append(position)
        self.counters.damaged = self._decoder.damaged + self._unreadable
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return positions

    def _is_alive(self) -> bool:
        heard, self._heard = self._heard, False
        return heard


class NmeaReceiver(Receiver[nmea.Sentence]):
    """Any receiver that sends GGA sentences."""

    def __init__(
        self,
        url: str,
        bit_rate: int = NMEA_BIT_RATE,
        **options: Unpack[DeviceOptions],
    ) -> None:
        framing = nmea.NmeaFraming()
        super().__init__(url, bit_rate, framing, **options)

    def _position(self, frame: nmea.Sentence, stamp_s: float) -> SatellitePosition | None:
        if frame.kind != "GGA":
            return None
        fix = nmea.position_fix(frame)
        return SatellitePosition(
            stamp_s=stamp_s,
            has_fix=fix.quality.is_measured and not math.isnan(fix.latitude_deg + fix.longitude_deg),
            is_corrected=fix.quality.is_corrected,
            latitude_deg=fix.latitude_deg,
            longitude_deg=fix.longitude_deg,
            height_m=fix.altitude_m + fix.geoid_m,
            horizontal_m=fix.horizontal_dilution * M_PER_DILUTION,
            vertical_m=2 * fix.horizontal_dilution * M_PER_DILUTION,
            satellites=fix.satellites,
        )


class UbxReceiver(Receiver[ubx.UbxMessage]):
    """A u-blox receiver; it is told to send its solution (NAV-PVT).

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        bit_rate: bit/s.
        period_s: time between two solutions.
        options: see `DeviceOptions`.
    """

    def __init__(
        self,
        url: str,
        bit_rate: int = UBX_BIT_RATE,
        period_s: float = 0.2,
        **options: Unpack[DeviceOptions],
    ) -> None:
        framing = ubx.UbxFraming()
        super().__init__(url, bit_rate, framing, **options)
        self._period_ms = round(1000 * period_s)

    def _start(self, port: Port) -> None:
        port.write(ubx.set_rate(self._period_ms) + ubx.enable_message(0x01, 0x07))

    def _position(self, frame: ubx.UbxMessage, stamp_s: float) -> SatellitePosition | None:
        if (frame.message_class, frame.number) != (0x01, 0x07):
            return None
        solution = ubx.navigation_solution(frame)
        return SatellitePosition(
            stamp_s=stamp_s,
            has_fix=solution.valid
            and solution.fix_type in (ubx.FixType.TWO_D, ubx.FixType.THREE_D, ubx.FixType.COMBINED),
            is_corrected=solution.is_corrected,
            latitude_deg=solution.latitude_deg,
            longitude_deg=solution.longitude_deg,
            height_m=solution.height_m,
            horizontal_m=solution.horizontal_accuracy_m,
            vertical_m=solution.vertical_accuracy_m,
            satellites=solution.satellites,
        )
