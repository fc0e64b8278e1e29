"""The driver of SICK's TiM and LMS1xx understands CoLa as text and binary."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.sick.cola import (
    LOG_IN,
    STREAM,
    BinaryFraming,
    DamagedTelegram,
    Dialect,
    TextReader,
    checksum,
    framed,
    scan_data,
)
from robbie_robots.hw.sick.cola_laser import SickColaLaser, complaint_of
from tests.hw._support.captures import CAPTURES, needs_captures
from tests.hw._support.scripted_port import ScriptedPort

# The beginning of a real TiM's telegram, with five beams in place of 271.
TEXT = (
    b"sSN LMDscandata 1 1 107375C 0 0 2AD8 2ADD 7907F6FD 79080660 0 0 1 0 0 5DC 36 0 1 "
    b"DIST1 3F800000 00000000 FFF92230 2710 5 116 120 0 11D 120 "
    b"1 RSSI1 3F800000 00000000 FFF92230 2710 5 9A 9D 0 97 93 0 1 B not defined 0 0 0"
)


def binary(values: list[int], start_us: int = 0xB3A805E3, counter: int = 1) -> bytes:
    """Return a payload laid out as in a real TiM's telegrams, with the given distances."""
    head = struct.pack(">HHIBBHHIIBBBBHIIHH", 1, 1, 18480390, 0, 0, counter, counter, start_us, start_us,
                       0, 0, 8, 0, 0, 1500, 162, 0, 1)  # fmt: skip
    channel = b"DIST1" + struct.pack(">ffiHH", 1.0, 0.0, -450_000, 3333, len(values))
    return b"sSN LMDscandata " + head + channel + np.array(values, ">u2").tobytes() + bytes(2)


def laser(dialect: Dialect) -> SickColaLaser:
    return SickColaLaser("socket://nowhere", clock=lambda: 9.0, dialect=dialect)


def test_answer_of_a_real_laser_has_the_right_frame_and_checksum() -> None:
    real = bytes.fromhex(
        "02 02 02 02 00 00 00 13 73 41 4E 20 53 65 74 41 63 63 65 73 73 4D 6F 64 65 20 01 38"
    )
    assert FrameDecoder(BinaryFraming()).feed(real) == [b"sAN SetAccessMode \x01"]
    assert framed(b"sAN SetAccessMode \x01") == real
    assert checksum(b"") == 0


def test_commands_are_written_in_both_dialects() -> None:
    assert LOG_IN.frame(Dialect.A) == b"\x02sMN SetAccessMode 03 F4724744\x03"
    assert STREAM.frame(Dialect.A) == b"\x02sEN LMDscandata 1\x03"
    assert FrameDecoder(BinaryFraming()).feed(LOG_IN.frame(Dialect.B)) == [
        b"sMN SetAccessMode \x03\xf4\x72\x47\x44"
    ]


def test_text_of_a_real_laser_has_its_ranges_and_intensities() -> None:
    driver = laser(Dialect.A)
    (sweep,) = driver._take(b"\x02" + TEXT + b"\x03")
    np.testing.assert_allclose(sweep.ranges_m, [0.278, 0.288, math.inf, 0.285, 0.288], rtol=1e-6)
    assert sweep.intensities is not None and sweep.intensities.tolist() == [154, 157, 0, 151, 147]
    assert math.degrees(driver.geometry.angle_min_rad) == pytest.approx(-45 - 90)
    assert math.degrees(driver.geometry.angle_increment_rad) == pytest.approx(1.0)
    assert driver.period_s == pytest.approx(1 / 15)
    assert driver.serial_number == 0x107375C
    assert scan_data(TEXT, Dialect.A).scan_counter == 0x2ADD


def test_binary_and_text_say_the_same() -> None:
    (channel,) = scan_data(binary([627, 2, 65535]), Dialect.B).channels
    assert (channel.name, channel.start_1e4_deg, channel.step_1e4_deg) == ("DIST1", -450_000, 3333)
    assert channel.values.tolist() == [627, 2, 65535]


def test_scale_of_an_lms5xx_is_applied() -> None:
    (sweep,) = laser(Dialect.A)._take(b"\x02" + TEXT.replace(b"DIST1 3F8", b"DIST1 400") + b"\x03")
    assert sweep.ranges_m[0] == pytest.approx(0.556)


@pytest.mark.parametrize(
    "text",
    [b"sSN LMDscandata", TEXT[:150], TEXT.replace(b" 5 116", b" 900 116"), TEXT.replace(b"116", b"1Z6")],
)
def test_damaged_text_is_no_scan(text: bytes) -> None:
    with pytest.raises(DamagedTelegram, match="not a whole LMDscandata"):
        scan_data(text, Dialect.A)
    driver = laser(Dialect.A)
    assert driver._take(b"\x02" + text + b"\x03") == []
    assert driver.counters.damaged == 1


def test_telegram_behind_a_cut_one_is_found() -> None:
    whole = b"\x02" + TEXT + b"\x03"
    reader = TextReader()
    assert reader.feed(whole[:200] + whole + whole) == [TEXT, TEXT]
    assert (reader.damaged, reader.skipped_bytes) == (1, 200)


@given(st.binary(max_size=400))
def test_no_bytes_raise_an_error(data: bytes) -> None:
    for dialect in Dialect:
        laser(dialect)._take(data)
    laser(Dialect.B)._take(framed(b"sSN LMDscandata " + data))
    laser(Dialect.A)._take(b"\x02sSN LMDscandata " + data + b"\x03")


@needs_captures
def test_scans_of_a_real_tim_as_text_have_the_numbers_of_the_capture() -> None:
    lines = (CAPTURES / "sick_cola/tim_colaA_captured.txt").read_bytes().splitlines()
    scans = 0
    for line in lines:
        words = line.split()
        if len(words) < 100:
            continue
        data = scan_data(line, Dialect.A)
        assert data.channels[0].values.tolist() == [int(word, 16) for word in words[26 : 26 + 271]]
        assert [channel.name for channel in data.channels] == ["DIST1", "RSSI1"]
        assert [len(channel.values) for channel in data.channels] == [271, 271]
        assert (data.serial_number, data.scan_rate_hz) == (0x107375C, 15.0)
        scans += 1
    assert scans == 2


def tcp_payload(pcapng: bytes) -> bytes:
    """Return what one connection in a file of Wireshark's carries, in the order recorded."""
    at, found = 0, []
    while at < len(pcapng):
        kind, length = struct.unpack_from("<II", pcapng, at)
        if kind == 6:
            captured = struct.unpack_from("<I", pcapng, at + 20)[0]
            packet = pcapng[at + 28 : at + 28 + captured]
            ip = packet[14:]
            if packet[12:14] == b"\x08\x00" and ip[9] == 6:
                ip = ip[: int.from_bytes(ip[2:4], "big")]
                tcp = ip[4 * (ip[0] & 15) :]
                found.append((int.from_bytes(tcp[:2], "big"), tcp[4 * (tcp[12] >> 4) :]))
        at += length
    port = max(
        {port for port, _ in found}, key=lambda port: sum(len(data) for one, data in found if one == port)
    )
    return b"".join(data for one, data in found if one == port)


@needs_captures
def test_scans_of_a_real_tim_in_binary_follow_one_another() -> None:
    stream = tcp_payload((CAPTURES / "sick_cola/sick_scan_xd_test.pcapng").read_bytes())
    reader = FrameDecoder(BinaryFraming())
    scans = [scan_data(payload, Dialect.B) for payload in reader.feed(stream)]
    assert len(scans) >= 15 and reader.damaged == 0
    counters = [scan.scan_counter for scan in scans]
    assert counters == list(range(counters[0], counters[0] + len(scans)))
    for scan in scans:
        (distances, *_) = scan.channels
        assert (distances.step_1e4_deg, len(distances.values), scan.scan_rate_hz) == (3333, 811, 15.0)
    periods = np.diff([scan.start_us for scan in scans])
    np.testing.assert_allclose(periods, 66_667, atol=1_500)
    # By eye in the bytes: 02 72, 02 91, 02 68.
    assert scans[0].channels[0].values[:3].tolist() == [0x272, 0x291, 0x268]


@pytest.mark.parametrize("dialect", Dialect)
def test_laser_is_configured_and_its_stream_started(dialect: Dialect) -> None:
    answers = {"sMN": "sAN", "sWN": "sWA", "sEN": "sEA"}

    def answer(written: bytes, _: int) -> bytes:
        text = written[1:-1] if dialect is Dialect.A else written[8:-1]
        verb, name = text.split(b" ")[:2]
        told = f"{answers[verb.decode()]} {name.decode()} 1".encode()
        scan = TEXT if dialect is Dialect.A else binary([500] * 5)
        frames = [told, scan] if name == b"LMDscandata" else [told]
        return b"".join(b"\x02" + one + b"\x03" if dialect is Dialect.A else framed(one) for one in frames)

    driver = SickColaLaser("scripted", clock=lambda: 9.0, dialect=dialect, intensities=True)
    port = ScriptedPort(answer)
    driver._open_port = port.opened
    assert len(driver.poll()) == 1
    assert [b"SetAccessMode" in one for one in port.written] == [True, False, False, False, False]
    assert len(port.written) == 5
    driver.close()


@pytest.mark.parametrize(
    ("status", "complaint"),
    [(0, ""), (1, "an error (device status 1)"), (2, "is dirty"), (5, "too dirty to measure")],
)
def test_complaint_of_a_laser_is_in_its_status(status: int, complaint: str) -> None:
    assert complaint in complaint_of(status)
    assert bool(complaint_of(status)) == bool(complaint)


def test_error_of_a_laser_is_told() -> None:
    driver = SickColaLaser("scripted", clock=lambda: 9.0, dialect=Dialect.A)
    driver._open_port = ScriptedPort(lambda written, _: b"\x02sFA 8\x03").opened
    assert driver.poll() == []
    assert driver.reason == "the laser answers sEN LMDscandata with the error b'8'"
