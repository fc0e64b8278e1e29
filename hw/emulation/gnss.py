"""Emulated GNSS receivers: one that speaks NMEA 0183, and a u-blox with UBX as well.

Sources: NMEA 0183 Standard for Interfacing Marine Electronic Devices; u-blox 8 / u-blox M8 Receiver
Description including Protocol Specification.
"""

import math
import struct
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.fletcher import fletcher

KNOT_M_PER_S = 0.514444
SYNC = b"\xb5\x62"
NAV_PVT, CFG_RATE, CFG_MSG, MON_VER = (0x01, 0x07), (0x06, 0x08), (0x06, 0x01), (0x0A, 0x04)
CFG, ACK, NAK = 0x06, (0x05, 0x01), (0x05, 0x00)
# When the clock of the device shows 0.
EPOCH = datetime(2026, 1, 1, tzinfo=timezone.utc)
# A Thursday; the week of the satellites begins on Sunday, and they count no leap seconds: 18 by now.
EPOCH_IN_GPS_WEEK_S = 4 * 86_400 + 18
GPS_WEEK_S = 604_800
MAX_COMMAND_BYTES = 1024


@dataclass
class Fix:
    """Where the receiver is; set it to your liking.

    Attributes:
        latitude_deg: north.
        longitude_deg: east.
        altitude_m: above the mean sea level.
        geoid_m: of the mean sea level above the ellipsoid.
        speed_m_per_s: over ground.
        course_deg: over ground, clockwise from north.
        quality: of NMEA: 0 none, 1 GPS, 2 DGPS, 4 RTK fixed, 5 RTK float, 6 dead reckoning, 9 SBAS.
        satellites: in use.
        hdop: horizontal dilution of precision.
        horizontal_m: horizontal accuracy.
        vertical_m: vertical accuracy.
    """

    latitude_deg: float = 50.363
    longitude_deg: float = 7.559
    altitude_m: float = 80.0
    geoid_m: float = 47.5
    speed_m_per_s: float = 0.0
    course_deg: float = 0.0
    quality: int = 1
    satellites: int = 9
    hdop: float = 0.9
    horizontal_m: float = 1.5
    vertical_m: float = 2.5


class EmulatedNmea(EmulatedDevice):
    """A receiver that sends GGA and RMC; `fix` is where it is."""

    def __init__(
        self, clock: EmulatedClock | None = None, bit_rate: int = 9_600, period_s: float = 1.0
    ) -> None:
        super().__init__(clock)
        self.bit_rate, self._period_s = bit_rate, period_s
        self.fix = Fix()
        self.power_on()

    def power_on(self) -> None:
        """Begin to send."""
        self._next_s = self.clock.now_s()

    def receive(self, data: bytes) -> None:
        """Hear nothing: plain receivers have no commands."""

    def step(self) -> float | None:
        """Send the sentences that are due."""
        now_s = self.clock.now_s()
        while self._next_s <= now_s:
            for frame in self.frames(self._next_s):
                self.send(frame)
            self._next_s += self._period_s
        return self._next_s

    def frames(self, now_s: float) -> list[bytes]:
        """Return what is sent for one fix."""
        fix, now = self.fix, EPOCH + timedelta(seconds=now_s)
        at = f"{now:%H%M%S}.{now.microsecond // 10_000:02d}"
        if not fix.quality:
            return [
                sentence(f"GPGGA,{at},,,,,0,00,99.99,,M,,M,,"),
                sentence(f"GPRMC,{at},V,,,,,,,{now:%d%m%y},,,N"),
            ]
        place = f"{_angle(fix.latitude_deg, 2, 'NS')},{_angle(fix.longitude_deg, 3, 'EW')}"
        height = f"{fix.altitude_m:.2f},M,{fix.geoid_m:.1f},M"
        gga = f"{place},{fix.quality},{fix.satellites:02d},{fix.hdop:.2f},{height},,"
        rmc = f"{place},{fix.speed_m_per_s / KNOT_M_PER_S:.3f},{fix.course_deg:.2f},{now:%d%m%y},,,A"
        return [sentence(f"GPGGA,{at},{gga}"), sentence(f"GPRMC,{at},A,{rmc}")]


class EmulatedUblox(EmulatedNmea):
    """A u-blox: NMEA until a host switches NAV-PVT on by CFG-MSG; it also knows CFG-RATE and MON-VER."""

    def power_on(self) -> None:
        """Begin to send NMEA at 1 Hz."""
        super().power_on()
        self._received = bytearray()
        self._period_s = 1.0
        self.sends_nav_pvt, self.sends_nmea = False, True

    def receive(self, data: bytes) -> None:
        """Answer frames whose checksum is right."""
        self._received += data
        while (start := self._received.find(SYNC)) >= 0:
            del self._received[:start]
            if len(self._received) < 6:
                return
            length = 8 + int.from_bytes(self._received[4:6], "little")
            if length > MAX_COMMAND_BYTES:
                del self._received[:1]
                continue
            if len(self._received) < length:
                return
            whole = bytes(self._received[:length])
            if fletcher(whole[2:-2]) != whole[-2:]:
                del self._received[:1]
                continue
            del self._received[:length]
            self._obey((whole[2], whole[3]), whole[6:-2])
        del self._received[:-1]

    def frames(self, now_s: float) -> list[bytes]:
        """Return what is sent for one fix."""
        frames = super().frames(now_s) if self.sends_nmea else []
        if self.sends_nav_pvt:
            frames.append(ubx(NAV_PVT, self._nav_pvt(now_s)))
        return frames

    def _obey(self, kind: tuple[int, int], data: bytes) -> None:
        if kind == MON_VER and not data:
            self.send(ubx(MON_VER, b"ROM CORE 3.01 (107888)".ljust(30, b"\0") + b"00080000".ljust(10, b"\0")))
        elif kind == NAV_PVT and not data:
            self.send(ubx(NAV_PVT, self._nav_pvt(self.clock.now_s())))
        elif kind[0] == CFG:
            self.send(ubx(ACK if self._configure(kind, data) else NAK, bytes(kind)))

    def _configure(self, kind: tuple[int, int], data: bytes) -> bool:
        """Take over a setting; return whether it is known."""
        if kind == CFG_RATE and len(data) == 6:
            period_ms = int.from_bytes(data[:2], "little")
            if period_ms < 50:
                return False
            self._period_s = period_ms / 1000
            return True
        if kind == CFG_MSG and len(data) in (3, 8):
            # With a rate for each port: that of the serial line.
            rate = data[2] if len(data) == 3 else data[3]
            if (data[0], data[1]) == NAV_PVT:
                self.sends_nav_pvt = bool(rate)
            elif data[0] == 0xF0 and data[1] in (0x00, 0x04):
                self.sends_nmea = bool(rate)
            return True
        return kind in ((0x06, 0x00), (0x06, 0x24), (0x06, 0x8A), (0x06, 0x09))

    def _nav_pvt(self, now_s: float) -> bytes:
        fix, now = self.fix, EPOCH + timedelta(seconds=now_s)
        is_fixed = bool(fix.quality)
        course = math.radians(fix.course_deg)
        velocity = [1000 * fix.speed_m_per_s * part for part in (math.cos(course), math.sin(course), 0.0)]
        of_week_ms = round((now_s + EPOCH_IN_GPS_WEEK_S) * 1000) % (GPS_WEEK_S * 1000)
        start = struct.pack(
            "<IHBBBBBBIi", of_week_ms, now.year, now.month, now.day, now.hour,
            now.minute, now.second, 7, 20, now.microsecond * 1000,
        )  # fmt: skip
        start += bytes([3 if is_fixed else 0, int(is_fixed), 0, fix.satellites if is_fixed else 0])
        place = struct.pack(
            "<iiiiII", round(fix.longitude_deg * 1e7), round(fix.latitude_deg * 1e7),
            round(1000 * (fix.altitude_m + fix.geoid_m)), round(1000 * fix.altitude_m),
            round(1000 * fix.horizontal_m), round(1000 * fix.vertical_m),
        )  # fmt: skip
        motion = struct.pack(
            "<iiiiiIIH", *map(round, velocity), round(1000 * fix.speed_m_per_s), round(fix.course_deg * 1e5),
            100, 500_000, round(100 * fix.hdop),
        )  # fmt: skip
        return (start + place + motion).ljust(92, b"\0")


def sentence(text: str) -> bytes:
    """Return a sentence with its checksum."""
    check = 0
    for character in text.encode():
        check ^= character
    return f"${text}*{check:02X}\r\n".encode()


def ubx(kind: tuple[int, int], payload: bytes = b"") -> bytes:
    """Return a frame with its checksum."""
    body = bytes(kind) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + fletcher(body)


def _angle(degrees: float, digits: int, signs: str) -> str:
    """Return an angle as degrees and minutes, with a letter for its sign."""
    # Rounded first, so that there are never 60 minutes.
    units = round(abs(degrees) * 60 * 100_000)
    whole, rest = divmod(units, 60 * 100_000)
    return f"{whole:0{digits}d}{rest / 100_000:08.5f},{signs[degrees < 0]}"
