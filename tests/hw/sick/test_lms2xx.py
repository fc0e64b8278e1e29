"""The driver of SICK's LMS2xx speaks the maker's telegrams, and puts interlaced scans together."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.sick.lms2xx import SickLms2xx
from robbie_robots.hw.sick.lms2xx_telegrams import (
    DamagedScan,
    TelegramFraming,
    complaint_of,
    crc,
    least_code,
    scan,
    telegram,
)
from tests.hw._support.scripted_port import ScriptedPort


def reply(command: int, data: bytes, status: int = 0x10, address: int = 0x80) -> bytes:
    inside = bytes([command]) + data + bytes([status])
    body = b"\x02" + bytes([address]) + len(inside).to_bytes(2, "little") + inside
    return body + crc(body).to_bytes(2, "little")


def scan_telegram(values: list[int], head: int = 0) -> bytes:
    return reply(0xB0, (head | len(values)).to_bytes(2, "little") + np.array(values, "<u2").tobytes())


@pytest.mark.parametrize(
    ("command", "data", "told"),
    [
        (0x31, "", "02 00 01 00 31 15 12"),
        (0x3A, "", "02 00 01 00 3A 1E 12"),
        (0x74, "", "02 00 01 00 74 50 12"),
        (0x20, "24", "02 00 02 00 20 24 34 08"),
        (0x20, "25", "02 00 02 00 20 25 35 08"),
        (0x30, "01", "02 00 02 00 30 01 31 18"),
        (0x20, "40", "02 00 02 00 20 40 50 08"),
        (0x20, "41", "02 00 02 00 20 41 51 08"),
        (0x20, "42", "02 00 02 00 20 42 52 08"),
        (0x20, "48", "02 00 02 00 20 48 58 08"),
        (0x3B, "B4 00 64 00", "02 00 05 00 3B B4 00 64 00 97 49"),
        (0x3B, "B4 00 32 00", "02 00 05 00 3B B4 00 32 00 3B 1F"),
        (0x3B, "64 00 19 00", "02 00 05 00 3B 64 00 19 00 E7 72"),
        (0x3B, "64 00 64 00", "02 00 05 00 3B 64 00 64 00 1D 0F"),
        (0x20, "00 53 49 43 4B 5F 4C 4D 53", "02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5"),
    ],
)
def test_commands_are_those_of_the_manual(command: int, data: str, told: str) -> None:
    assert telegram(command, bytes.fromhex(data)) == bytes.fromhex(told)


@pytest.mark.parametrize("told", ["02 80 03 00 A0 00 10 16 0A", "02 81 03 00 A0 00 10 36 1A"])
def test_replies_of_the_manual_are_understood_between_acknowledgements(told: str) -> None:
    frame = bytes.fromhex(told)
    assert FrameDecoder(TelegramFraming()).feed(b"\x06" + frame + b"\x15\x06" + frame) == [frame, frame]


def test_acknowledgement_bytes_within_a_scan_are_data() -> None:
    frame = scan_telegram([0x0606, 0x0615, 0x0202] * 60)
    (found,) = FrameDecoder(TelegramFraming()).feed(b"\x06" + frame)
    assert scan(found).values.tolist() == [0x0606, 0x0615, 0x0202] * 60


def test_whole_scan_has_the_length_of_the_manual() -> None:
    frame = scan_telegram([100] * 361)
    assert (len(frame), frame[2:4]) == (732, b"\xd6\x02")


def test_flags_and_units_are_told_apart_from_distances() -> None:
    in_mm = scan(scan_telegram([0x2000 | 1234, 1234], head=0x4000))
    assert (in_mm.values.tolist(), in_mm.unit_m, in_mm.partial) == ([1234, 1234], 0.001, None)
    in_cm = scan(scan_telegram([0x8000 | 8000]), range_bits=15)
    assert (in_cm.values.tolist(), in_cm.unit_m) == ([8000], 0.01)
    assert scan(scan_telegram([5], head=0x3800)).partial == 3
    assert least_code(13) == 0x1FF7


def test_scan_shorter_than_it_says_is_damaged() -> None:
    with pytest.raises(DamagedScan, match="361 values in a telegram of"):
        scan(reply(0xB0, (361).to_bytes(2, "little") + bytes(20)))


def driven(field_deg: int, resolution_deg: float) -> SickLms2xx:
    return SickLms2xx("/no/such/port", clock=lambda: 5.0, field_deg=field_deg, resolution_deg=resolution_deg)


def test_codes_and_far_values_are_no_return() -> None:
    values = [100, 0x1FFF, 0x1FFE, 0x1FF7, 800, 801] + [300] * 95
    (sweep,) = driven(100, 1.0)._take(scan_telegram(values))
    expected = [1.0, math.inf, math.inf, math.inf, 8.0, math.inf] + [3.0] * 95
    np.testing.assert_allclose(sweep.ranges_m, expected)


def test_four_interlaced_scans_become_one() -> None:
    laser, whole = driven(100, 0.25), [100 + beam for beam in range(401)]
    stream = [scan_telegram(whole[part::4], 0x2000 | part << 11) for part in range(4)]
    # It begins in the middle of one scan, and loses a part of the next.
    sweeps = laser._take(b"".join(stream[2:] + stream[:1] + stream[2:] + stream + stream))
    assert len(sweeps) == 2
    np.testing.assert_allclose(sweeps[0].ranges_m, np.array(whole) / 100, rtol=1e-6)
    assert laser.geometry.beams == 401
    assert math.degrees(laser.geometry.angle_max_rad) == pytest.approx(50.0)
    assert laser.period_s == pytest.approx(4 / 75)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: SickLms2xx("x", bit_rate=115_200),
        lambda: SickLms2xx("x", field_deg=90),
        lambda: SickLms2xx("x", field_deg=180, resolution_deg=0.25),
    ],
)
def test_what_the_scanner_does_not_know_is_refused(wrong: Callable[[], SickLms2xx]) -> None:
    with pytest.raises(ValueError, match="scanner"):
        wrong()


@given(st.binary(max_size=1500))
def test_no_bytes_raise_an_error(data: bytes) -> None:
    driven(180, 0.5)._take(data)
    driven(180, 0.5)._take(reply(0xB0, data[:800]))


def test_scanner_is_found_at_its_bit_rate_and_switched_to_the_wanted_one() -> None:
    scanner_rate = [9_600]

    def answer(written: bytes, bit_rate: int) -> bytes:
        if bit_rate != scanner_rate[0]:
            return b"\xff\x00\xf0"
        if written[4] == 0x3B:
            return b"\x06" + reply(0xBB, b"\x01" + written[5:9])
        if written[5] in (0x40, 0x48):
            scanner_rate[0] = 38_400 if written[5] == 0x40 else 500_000
        scans = scan_telegram([500] * 361) * 2 if written[5] == 0x24 else b""
        return b"\x06" + reply(0xA0, b"\x00") + scans

    port = ScriptedPort(answer)
    laser = SickLms2xx("scripted", clock=lambda: 5.0, bit_rate=500_000)
    laser._open_port = port.opened
    assert [float(sweep.ranges_m[0]) for sweep in laser.poll()] == [5.0, 5.0]
    assert port.bit_rate == scanner_rate[0] == 500_000
    laser.close()
    assert port.written[-1] == telegram(0x20, b"\x25")


@pytest.mark.parametrize(
    ("status", "complaint"), [(0x10, ""), (0x92, "dirty"), (0x13, "an error (status 0x13)"), (0x12, "")]
)
def test_complaint_of_a_scanner_is_in_its_status(status: int, complaint: str) -> None:
    assert complaint in complaint_of(status)
    assert bool(complaint_of(status)) == bool(complaint)


def test_scanner_that_refuses_a_field_is_told() -> None:
    def answer(written: bytes, _: int) -> bytes:
        return reply(0xBB, b"\x00" + written[5:9]) if written[4] == 0x3B else reply(0xA0, b"\x00")

    laser = SickLms2xx("scripted", clock=lambda: 5.0)
    laser._open_port = ScriptedPort(answer).opened
    assert laser.poll() == []
    assert "the scanner refuses 180 degrees by 0.5" in laser.reason
