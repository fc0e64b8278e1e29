"""The decoders under test, with intact frames for each."""

import struct
from collections.abc import Callable
from random import Random
from typing import Any

from hw.dynamixel import protocol1, protocol2
from hw.flir.ptu_protocol import PtuFraming
from hw.framing import FrameDecoder, Framing
from hw.gnss import nmea, ubx
from hw.irobot import open_interface
from hw.microstrain import mip
from hw.pioneer import p2os
from hw.xsens import xbus
from tools.fuzz_decoders.fuzz import Decoder, Subject

# What the driver of the Create 2 asks for.
STREAM = (7, 34, 19, 43)


class Reading(FrameDecoder[Any]):
    """A decoder whose frames are read to the last field, as a driver does; unreadable ones are dropped."""

    def __init__(self, framing: Framing[Any], read: Callable[[Any], object]) -> None:
        super().__init__(framing)
        self._read = read

    def feed(self, data: bytes) -> list[Any]:
        """Add bytes; return the frames that are now complete."""
        frames = super().feed(data)
        for frame in frames:
            try:
                self._read(frame)
            except ValueError:
                # Also `DamagedFrame`: the driver counts it and goes on.
                continue
        return frames


def _create_frame(random: Random) -> bytes:
    data = b"".join(
        bytes([number]) + random.randbytes(open_interface.struct_of(number).size) for number in STREAM
    )
    frame = bytes([open_interface.STREAM_HEADER, len(data)]) + data
    return frame + bytes([open_interface.checksum(frame)])


def _sip(random: Random) -> bytes:
    sonars = random.randint(0, 8)
    start = random.randbytes(18) + bytes([sonars])
    return p2os.packet(b"\x32" + start + random.randbytes(3 * sonars + random.choice((0, 12))))


def _mtdata2(random: Random) -> bytes:
    parts = struct.pack(">HBH", 0x1020, 2, random.getrandbits(16))
    for identifier, count in ((0x2010, 4), (0x4020, 3), (0x8020, 3)):
        parts += struct.pack(">HB", identifier, 4 * count) + random.randbytes(4 * count)
    return xbus.message(xbus.MessageId.DATA2, parts)


def _mip_packet(random: Random) -> bytes:
    kinds = (mip.SensorField.ACCELERATION, mip.SensorField.TURN_RATE)
    return mip.packet(
        mip.DescriptorSet.SENSOR_DATA, [mip.MipField(kind, random.randbytes(12)) for kind in kinds]
    )


def _gga(random: Random) -> bytes:
    minutes = random.uniform(0, 60)
    return nmea.sentence(f"GNGGA,123519.00,48{minutes:08.5f},N,01131.00000,E,1,08,0.9,545.4,M,46.9,M,,")


def _pvt(random: Random) -> bytes:
    return ubx.message(0x01, 0x07, random.randbytes(92))


def _status1(random: Random) -> bytes:
    return protocol1.packet(random.randrange(253), random.randrange(128), random.randbytes(4))


def _status2(random: Random) -> bytes:
    return protocol2.packet(random.randrange(253), 0x55, b"\0" + random.randbytes(10))


def _ptu_answer(random: Random) -> bytes:
    return b"* %d\r\n" % random.randint(-3090, 3090)


def _framed(
    framing: Callable[[], Framing[Any]], read: Callable[[Any], object] = bool
) -> Callable[[], Decoder]:
    return lambda: Reading(framing(), read)


SUBJECTS = {
    "irobot": Subject(_framed(lambda: open_interface.StreamFraming(STREAM)), _create_frame),
    "p2os": Subject(_framed(p2os.P2osFraming, p2os.server_information), _sip),
    "xsens": Subject(_framed(xbus.XbusFraming, xbus.data2), _mtdata2),
    "mip": Subject(_framed(mip.MipFraming, mip.sensor_values), _mip_packet),
    "nmea": Subject(_framed(nmea.NmeaFraming, nmea.position_fix), _gga),
    "ubx": Subject(_framed(ubx.UbxFraming, ubx.navigation_solution), _pvt),
    "dynamixel1": Subject(_framed(protocol1.Protocol1Framing), _status1),
    "dynamixel2": Subject(_framed(protocol2.Protocol2Framing, protocol2.status), _status2),
    "ptu": Subject(_framed(PtuFraming), _ptu_answer),
}
