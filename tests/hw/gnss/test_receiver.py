"""The drivers of receivers of satellite navigation systems."""

import struct
from typing import Any

from robbie_robots.hw.gnss import nmea, ubx
from robbie_robots.hw.gnss.receiver import NmeaReceiver, UbxReceiver
from tests.hw._support.line import Clock, ScriptedDevice


class Plugged:
    """A driver and its scripted receiver."""

    def __init__(self, kind: type[NmeaReceiver | UbxReceiver]) -> None:
        self.clock = Clock()
        self.device = ScriptedDevice()
        port: Any = self.device
        self.receiver = kind(
            "scripted", clock=self.clock, monotonic=self.clock, open_port=lambda url, rate: port
        )
        self.receiver.poll()


def gga(quality: int) -> bytes:
    return nmea.sentence(f"GPGGA,184353.07,1929.045,S,02410.506,E,{quality},04,2.0,100.00,M,-33.9,M,,0000")


def pvt(flags: int, fix_type: int) -> bytes:
    payload = bytearray(92)
    payload[20], payload[21], payload[23] = fix_type, flags, 9
    struct.pack_into("<iiii", payload, 24, -22402300, 534506925, 86000, 37889)
    struct.pack_into("<II", payload, 40, 1500, 2500)
    return ubx.message(1, 7, bytes(payload))


def test_nmea_position_has_height_above_the_ellipsoid() -> None:
    plugged = Plugged(NmeaReceiver)
    plugged.device.send(gga(1) + nmea.sentence("GPVTG,,T,,M,0.1,N,0.2,K,A") + gga(4))
    first, second = plugged.receiver.poll()
    assert first.has_fix and not first.is_corrected
    assert second.is_corrected
    assert abs(first.height_m - 66.1) < 1e-9
    assert (first.horizontal_m, first.stamp_s) == (6.0, plugged.clock.now_s)


def test_receiver_without_a_fix_says_so() -> None:
    plugged = Plugged(NmeaReceiver)
    plugged.device.send(gga(0) + nmea.sentence("GPGGA,,,,,,1,00,99.99,,,,,,"))
    assert [position.has_fix for position in plugged.receiver.poll()] == [False, False]


def test_position_of_quality_9_is_a_fix_and_dead_reckoning_is_none() -> None:
    plugged = Plugged(NmeaReceiver)
    plugged.device.send(b"".join(gga(quality) for quality in range(10)))
    assert [position.has_fix for position in plugged.receiver.poll()] == [
        quality in (1, 2, 3, 4, 5, 9) for quality in range(10)
    ]
    assert plugged.receiver.counters.damaged == 0


def test_positions_off_the_earth_are_dropped_and_counted() -> None:
    plugged = Plugged(NmeaReceiver)
    for place in ("1967.0,S,02410.5,E", "9100.0,N,02410.5,E", "1929.0,S,19130.0,E", "1929.0,S,,"):
        plugged.device.send(nmea.sentence(f"GPGGA,184353.07,{place},1,04,2.0,100.00,M,-33.9,M,,0000"))
    (half,) = plugged.receiver.poll()
    assert not half.has_fix and plugged.receiver.counters.damaged == 3


def test_ublox_positions_off_the_earth_or_marked_invalid_are_no_fix() -> None:
    plugged = Plugged(UbxReceiver)
    beyond = bytearray(pvt(flags=1, fix_type=3)[6:-2])
    struct.pack_into("<ii", beyond, 24, 1915000000, 910000000)
    marked = bytearray(pvt(flags=1, fix_type=3)[6:-2])
    marked[78] |= 1
    plugged.device.send(b"".join(ubx.message(1, 7, bytes(payload)) for payload in (beyond, marked)))
    assert [position.has_fix for position in plugged.receiver.poll()] == [False]
    assert plugged.receiver.counters.damaged == 1


def test_receiver_that_sends_other_sentences_only_stays_connected() -> None:
    plugged = Plugged(NmeaReceiver)
    for _ in range(10):
        plugged.clock.now_s += 1.0
        plugged.device.send(nmea.sentence("GPVTG,,T,,M,0.1,N,0.2,K,A"))
        assert plugged.receiver.poll() == []
    assert plugged.receiver.is_connected
    plugged.clock.now_s += 3.1
    plugged.receiver.poll()
    assert "nothing valid" in plugged.receiver.reason


def test_ublox_receiver_is_told_what_to_send_and_read() -> None:
    plugged = Plugged(UbxReceiver)
    assert plugged.device.taken() == ubx.set_rate(200) + ubx.enable_message(1, 7)
    plugged.device.send(
        gga(1) + pvt(flags=1, fix_type=3) + pvt(flags=3, fix_type=3) + pvt(flags=1, fix_type=5)
    )
    fixed, corrected, time_only = plugged.receiver.poll()
    assert (fixed.latitude_deg, fixed.height_m, fixed.satellites) == (53.4506925, 86.0, 9)
    assert (fixed.horizontal_m, fixed.vertical_m) == (1.5, 2.5)
    assert fixed.has_fix and not fixed.is_corrected
    assert corrected.is_corrected
    assert not time_only.has_fix
