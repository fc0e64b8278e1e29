"""The decoders under test, with intact frames for each."""

import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

from robbie_robots.hw.dynamixel import protocol1, protocol2
from robbie_robots.hw.flir.ptu_protocol import PtuFraming
from robbie_robots.hw.framing import FrameDecoder, Framing
from robbie_robots.hw.gnss import nmea, ubx
from robbie_robots.hw.hokuyo import scip
from robbie_robots.hw.hokuyo.laser import HokuyoLaser
from robbie_robots.hw.irobot import open_interface
from robbie_robots.hw.lctech.relay_protocol import RelayFraming
from robbie_robots.hw.microstrain import mip
from robbie_robots.hw.pioneer import p2os
from robbie_robots.hw.pluggable_laser import PluggableLaser
from robbie_robots.hw.rplidar import streams
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.hw.sick import cola, lms2xx_telegrams
from robbie_robots.hw.sick.cola import Dialect
from robbie_robots.hw.sick.cola_laser import SickColaLaser
from robbie_robots.hw.sick.lms2xx import SickLms2xx
from robbie_robots.hw.video.huffman import with_huffman_tables
from robbie_robots.hw.xsens import xbus
from tools.fuzz.decoders.fuzz import DecoderUnderTest, FuzzedDecoder

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


def _parameters(random: Random) -> bytes:
    names = b"".join(b"Robbie"[: random.randint(0, 6)] + b"\0" for _ in range(3))
    numbers = bytes(random.randrange(256) for _ in range(11)) + b"Robot\0"
    return p2os.packet(b"\x20" + names + numbers + random.randbytes(53))


def _p2os_packet(random: Random) -> bytes:
    return _sip(random) if random.getrandbits(2) else _parameters(random)


def _p2os_contents(packet: p2os.PioneerPacket) -> object:
    is_parameters = packet.number == p2os.PacketId.CONFIG
    return p2os.configuration(packet) if is_parameters else p2os.server_information(packet)


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


def _relay_answer(random: Random) -> bytes:
    return b"CH%d: %s\r\n" % (random.randint(1, 8), random.choice((b"ON", b"OFF")))


def _framed(
    framing: Callable[[], Framing[Any]], read: Callable[[Any], object] = bool
) -> Callable[[], FuzzedDecoder]:
    return lambda: Reading(framing(), read)


class LaserSweeps:
    """A laser's driver that is connected to nothing."""

    def __init__(self, laser: PluggableLaser) -> None:
        self._laser = laser

    def feed(self, data: bytes) -> list[bytes]:
        """Add bytes; return the ranges that are now complete."""
        return [sweep.ranges_m.tobytes() for sweep in self._laser._take(data)]


def _hokuyo() -> LaserSweeps:
    laser = HokuyoLaser("nowhere", clock=lambda: 0.0)
    told = {"DMIN": 20, "DMAX": 5600, "ARES": 1024, "AMIN": 44, "AMAX": 725, "AFRT": 384, "SCAN": 600}
    laser._set_geometry({name: str(value) for name, value in told.items()})
    laser._request = "MD0044072501000"
    return LaserSweeps(laser)


def _scip_sweep(random: Random) -> bytes:
    data = bytes(random.randrange(0x30, 0x70) for _ in range(3 * 682))
    lines = [b"99", b"0000", *(data[at : at + 64] for at in range(0, len(data), 64))]
    return b"MD0044072501000\n" + b"\n".join(line + scip.checksum(line) for line in lines) + b"\n\n"


def _lms2xx_scan(random: Random) -> bytes:
    inside = bytes([lms2xx_telegrams.SCAN]) + (361).to_bytes(2, "little") + random.randbytes(722) + b"\x10"
    body = b"\x02\x80" + len(inside).to_bytes(2, "little") + inside
    return body + lms2xx_telegrams.crc(body).to_bytes(2, "little")


def _cola_scan(random: Random) -> bytes:
    head = struct.pack(">HHIBBHHIIBBBBHIIHH", 1, 1, 5, 0, 0, 1, 1, random.getrandbits(32), 0, 0, 0, 0, 0, 0,
                       1500, 162, 0, 1)  # fmt: skip
    channel = b"DIST1" + struct.pack(">ffiHH", 1.0, 0.0, -450_000, 3333, 271) + random.randbytes(542)
    return cola.framed(b"sSN LMDscandata " + head + channel + bytes(2))


def _cola_text(random: Random) -> bytes:
    values = b" ".join(b"%X" % random.getrandbits(13) for _ in range(271))
    return (
        b"\x02sSN LMDscandata 1 1 107375C 0 0 2AD8 2ADD 7907F6FD 79080660 0 0 1 0 0 5DC 36 0 1 "
        b"DIST1 3F800000 00000000 FFF92230 2710 10F " + values + b" 0\x03"
    )


class RpLidarTurns:
    """The driver of an RPLidar that is connected to nothing and has started one of its streams."""

    def __init__(self, reader: type[streams.StreamReader]) -> None:
        self._laser = RpLidar("nowhere", clock=lambda: 0.0)
        self._reader = reader()
        # So few samples a second that no frame waits for others.
        self._laser._use(self._reader, 1.0, 0.01)
        self._newest: streams.Samples = streams.NO_SAMPLES
        decode = self._reader.samples

        def samples(frames: streams.Bytes) -> streams.Samples:
            self._newest = decode(frames)
            return self._newest

        self._reader.samples = samples  # type: ignore[method-assign]

    def feed(self, data: bytes) -> list[tuple[float, float]]:
        """Add bytes; return direction and distance of the samples that are now known."""
        self._newest = streams.NO_SAMPLES
        self._laser._take(data)
        return list(zip(self._newest.angles_deg, self._newest.distances_mm, strict=True))


def _checked(body: bytes) -> bytes:
    check = 0
    for byte in body:
        check ^= byte
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def _capsule(random: Random, data_bytes: int) -> bytes:
    # Not the beginning of a scan: bit 7 of the fourth byte.
    return _checked(bytes([random.getrandbits(8), random.getrandbits(6)]) + random.randbytes(data_bytes))


def _hq_capsule(random: Random) -> bytes:
    body = b"\xa5" + random.randbytes(136)
    return body + zlib.crc32(body + bytes(3)).to_bytes(4, "little")


def _nodes(random: Random) -> bytes:
    """Return several samples: five bytes with three check bits alone cannot be told from noise."""
    return b"".join(
        bytes([random.getrandbits(6) << 2 | 2, random.getrandbits(7) << 1 | 1, random.randrange(180)])
        + random.randbytes(2)
        for _ in range(32)
    )


class JpegImages:
    """What a camera's driver does with each image: the usual Huffman tables go into one without tables.

    An image that comes out must be the one that went in, but for the tables.
    """

    _TABLES = 420

    def feed(self, data: bytes) -> list[bytes]:
        """Take an image, or what is left of one; return it with tables."""
        image = with_huffman_tables(data)
        added = len(image) - len(data)
        at = next(
            (at for at, (old, new) in enumerate(zip(data, image, strict=False)) if old != new), len(data)
        )
        if added not in (0, self._TABLES) or data != image[:at] + image[at + added :]:
            raise AssertionError(f"{added} bytes were added, or others changed")
        return [image]


def _segment(mark: int, contents: bytes) -> bytes:
    return bytes([0xFF, mark]) + (len(contents) + 2).to_bytes(2, "big") + contents


def _jpeg_image(random: Random) -> bytes:
    """Return an image of 16 by 16 pixels, mostly without Huffman tables, with noise for its coefficients."""
    image = (
        b"\xff\xd8" + _segment(0xE0, b"AVI1" + bytes(10)) + _segment(0xDB, bytes([0]) + random.randbytes(64))
    )
    image += _segment(0xC0, bytes.fromhex("08 0010 0010 03 01 22 00 02 11 00 03 11 00"))
    if not random.getrandbits(3):
        image += _segment(0xC4, bytes(17))
    image += _segment(0xDA, bytes.fromhex("03 01 00 02 11 03 11 00 3f 00"))
    return image + random.randbytes(random.randrange(200)).replace(b"\xff", b"\xff\0") + b"\xff\xd9"


SUBJECTS = {
    "jpeg": DecoderUnderTest(JpegImages, _jpeg_image),
    "rplidar": DecoderUnderTest(lambda: RpLidarTurns(streams.NodeReader), _nodes),
    "rplidar-express": DecoderUnderTest(
        lambda: RpLidarTurns(streams.CapsuleReader), lambda random: _capsule(random, 80)
    ),
    "rplidar-dense": DecoderUnderTest(
        lambda: RpLidarTurns(streams.DenseReader), lambda random: _capsule(random, 80)
    ),
    "rplidar-ultra": DecoderUnderTest(
        lambda: RpLidarTurns(streams.UltraReader), lambda random: _capsule(random, 128)
    ),
    "rplidar-hq": DecoderUnderTest(lambda: RpLidarTurns(streams.HqReader), _hq_capsule),
    "hokuyo": DecoderUnderTest(_hokuyo, _scip_sweep),
    "lms2xx": DecoderUnderTest(lambda: LaserSweeps(SickLms2xx("nowhere", clock=lambda: 0.0)), _lms2xx_scan),
    "cola-a": DecoderUnderTest(
        lambda: LaserSweeps(SickColaLaser("nowhere", clock=lambda: 0.0, dialect=Dialect.A)), _cola_text
    ),
    "cola-b": DecoderUnderTest(lambda: LaserSweeps(SickColaLaser("nowhere", clock=lambda: 0.0)), _cola_scan),
    "irobot": DecoderUnderTest(_framed(lambda: open_interface.StreamFraming(STREAM)), _create_frame),
    "p2os": DecoderUnderTest(_framed(p2os.P2osFraming, _p2os_contents), _p2os_packet),
    "xsens": DecoderUnderTest(_framed(xbus.XbusFraming, xbus.data2), _mtdata2),
    "mip": DecoderUnderTest(_framed(mip.MipFraming, mip.sensor_values), _mip_packet),
    "nmea": DecoderUnderTest(_framed(nmea.NmeaFraming, nmea.position_fix), _gga),
    "ubx": DecoderUnderTest(_framed(ubx.UbxFraming, ubx.navigation_solution), _pvt),
    "dynamixel1": DecoderUnderTest(_framed(protocol1.Protocol1Framing), _status1),
    "dynamixel2": DecoderUnderTest(_framed(protocol2.Protocol2Framing, protocol2.status), _status2),
    "ptu": DecoderUnderTest(_framed(PtuFraming), _ptu_answer),
    "lcus": DecoderUnderTest(_framed(RelayFraming), _relay_answer),
}
