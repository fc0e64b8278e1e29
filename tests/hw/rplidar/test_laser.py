"""The driver of RPLidars understands both kinds of streams, and finds its place again."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.hw.rplidar.protocol import CAPSULES, NODES, Descriptor, descriptor, request
from robbie_robots.hw.rplidar.streams import READERS, CapsuleReader, NodeReader, Samples
from tests.hw._support.scripted_port import ScriptedPort


def node(angle_deg: float, distance_mm: float, quality: int = 15, is_first: bool = False) -> bytes:
    angle, distance = round(angle_deg * 64), round(distance_mm * 4)
    first = quality << 2 | (1 if is_first else 2)
    return bytes([first, angle << 1 & 0xFE | 1, angle >> 7]) + distance.to_bytes(2, "little")


def turn(count: int = 36, distance_mm: float = 1000.0) -> list[bytes]:
    return [node(360 * number / count, distance_mm + number, 15, number == 0) for number in range(count)]


def capsule(start_deg: float, distances_mm: list[int], is_new: bool = False) -> bytes:
    start = round(start_deg * 64) | (0x8000 if is_new else 0)
    body = start.to_bytes(2, "little")
    for one, two in zip(distances_mm[::2], distances_mm[1::2], strict=True):
        body += (one << 2).to_bytes(2, "little") + (two << 2).to_bytes(2, "little") + b"\x00"
    check = 0
    for byte in body:
        check ^= byte
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def test_requests_are_those_of_the_manual() -> None:
    assert request(0x82, bytes(5)) == bytes.fromhex("A5 82 05 00 00 00 00 00 22")
    assert request(0xF0, (660).to_bytes(2, "little")) == bytes.fromhex("A5 F0 02 94 02 C1")
    assert request(0x25) == bytes.fromhex("A5 25")


@pytest.mark.parametrize(
    ("told", "meant"),
    [
        ("A5 5A 14 00 00 00 04", Descriptor(20, False, 0x04)),
        ("A5 5A 03 00 00 00 06", Descriptor(3, False, 0x06)),
        ("A5 5A 05 00 00 40 81", Descriptor(5, True, 0x81)),
        ("A5 5A 54 00 00 40 82", Descriptor(84, True, 0x82)),
        ("A5 5A 04 00 00 00 15", Descriptor(4, False, 0x15)),
    ],
)
def test_descriptors_are_understood(told: str, meant: Descriptor) -> None:
    assert descriptor(bytes.fromhex(told)) == meant
    assert descriptor(bytes.fromhex(told)[:-1]) is None


def test_samples_have_their_angle_distance_and_quality() -> None:
    samples = NodeReader().feed(node(90.25, 1234.5, 47, True) + node(91, 0) + node(92, 16000.25))
    assert samples.angles_deg.tolist() == [90.25, 91.0, 92.0]
    assert samples.distances_mm.tolist() == [1234.5, 0.0, 16000.25]
    assert samples.qualities is not None and samples.qualities.tolist() == [47, 15, 15]
    assert samples.firsts.tolist() == [True, False, False]


def test_express_samples_lie_between_the_angles_of_two_capsules() -> None:
    first = capsule(350, list(range(100, 132)), is_new=True)
    assert len(first) == 84
    samples = CapsuleReader().feed(first + capsule(366 - 360, list(range(32))))
    assert samples.distances_mm.tolist() == list(range(100, 132))
    assert samples.angles_deg.tolist() == [(350 + number / 2) % 360 for number in range(32)]
    assert np.flatnonzero(samples.firsts).tolist() == [20]


def test_turn_that_begins_between_two_capsules_is_seen() -> None:
    capsules = [capsule(angle % 360, [1000] * 32) for angle in (340, 350, 360, 370, 380)]
    whole = CapsuleReader().feed(b"".join(capsules))
    assert np.flatnonzero(whole.firsts).tolist() == [64]
    # The same in pieces.
    reader = CapsuleReader()
    pieces = [reader.feed(one) for one in capsules]
    assert [np.flatnonzero(piece.firsts).tolist() for piece in pieces] == [[], [], [], [0], []]


def test_damaged_capsule_gives_no_samples_and_the_next_ones_do() -> None:
    good = [capsule(10 * number, [1000] * 32) for number in range(5)]
    bad = bytearray(good[1])
    bad[40] ^= 4
    reader = CapsuleReader()
    assert len(reader.feed(good[0] + bytes(bad) + b"".join(good[2:]))) == 2 * 32
    assert (reader.damaged, reader.gaps, reader.frames, reader.pending) == (1, 1, 4, 32)


def test_turn_becomes_a_sweep_that_counts_counter_clockwise() -> None:
    driver = RpLidar("/no/such/port", clock=lambda: 100.0, beams=36)
    (sweep,) = driver._take(b"".join(turn() + turn()))
    # 90 degrees clockwise of ahead is the right side: a quarter of the beams from the back.
    assert sweep.ranges_m[9] == pytest.approx(1.009)
    assert sweep.ranges_m[18] == pytest.approx(1.000)
    assert sweep.ranges_m[27] == pytest.approx(1.027)
    assert sweep.intensities is not None and set(sweep.intensities) == {15.0}


def test_sector_has_its_nearest_range_and_none_where_nothing_returned() -> None:
    driver = RpLidar("/no/such/port", clock=lambda: 100.0, beams=36)
    told = [node(0, 0, 0, True), node(10, 3000), node(11, 2000), node(12, 0), node(0, 0, 0, True), node(1, 0)]
    # So few bytes wait for others, or for a moment without any.
    assert driver._take(b"".join(told)) == []
    (sweep,) = driver._take(b"")
    assert sweep.ranges_m[17] == pytest.approx(2.0)
    assert np.isinf(np.delete(sweep.ranges_m, 17)).all()


def test_turn_that_lost_a_sample_is_left_out() -> None:
    driver = RpLidar("/no/such/port", clock=lambda: 100.0, beams=36)
    cut = b"".join(turn())[:-2]
    sweeps = driver._take(cut) + driver._take(b"".join(turn(distance_mm=2000) * 3))
    assert all(math.isclose(float(sweep.ranges_m[18]), 2.0, rel_tol=1e-6) for sweep in sweeps)
    assert driver.counters.damaged == 1


def same(one: Samples, other: Samples) -> bool:
    return np.array_equal(one.angles_deg, other.angles_deg) and np.array_equal(
        one.distances_mm, other.distances_mm
    )


@given(st.binary(max_size=500))
def test_no_bytes_raise_an_error(data: bytes) -> None:
    for reader in READERS.values():
        driver = RpLidar("/no/such/port", clock=lambda: 100.0)
        driver._use(reader(), 1e-4, 0.01)
        driver._take(data)
        driver._take(capsule(0, [5] * 32) + data + capsule(0, [5] * 32))


@pytest.mark.parametrize("express", [False, True])
def test_laser_is_asked_who_it_is_and_started(express: bool) -> None:
    # The beginning of the answers of a real A1.
    info = bytes.fromhex("A5 5A 14 00 00 00 04 18 1D 01 07") + bytes(range(16))

    def answer(written: bytes, _: int) -> bytes:
        stream = capsule(0, [1000] * 32) * 2 if express else b"".join(turn() + turn(1))
        kind = "54 00 00 40 82" if express else "05 00 00 40 81"
        return {
            0x50: info,
            0x52: bytes.fromhex("A5 5A 03 00 00 00 06 00 00 00"),
            0x59: bytes.fromhex("A5 5A 04 00 00 00 15 F4 01 FA 00"),
            0x20: bytes.fromhex("A5 5A" + kind) + stream,
            0x82: bytes.fromhex("A5 5A" + kind) + stream,
        }.get(written[1], b"")

    port = ScriptedPort(answer)
    driver = RpLidar("scripted", clock=lambda: 100.0, mode="express" if express else "standard")
    driver._open_port = port.opened
    assert len(driver.poll()) == (0 if express else 1)
    assert driver.is_connected and driver.identity.startswith("model 0x18, firmware 1.1d, hardware 7, 000102")
    assert driver.scan_mode is not None
    assert driver.scan_mode.sample_s == pytest.approx(250e-6 if express else 500e-6)
    assert driver.scan_mode.answer == (CAPSULES if express else NODES)
    assert port.motor_lines == [False]
    driver.close()
    assert port.motor_lines == [False, True]
    assert request(0x25) in port.written[-2:]


def test_broken_laser_is_reset_and_told() -> None:
    def answer(written: bytes, _: int) -> bytes:
        return {
            0x50: bytes.fromhex("A5 5A 14 00 00 00 04") + bytes(20),
            0x52: bytes.fromhex("A5 5A 03 00 00 00 06 02 01 80"),
        }.get(written[1], b"")

    port = ScriptedPort(answer)
    driver = RpLidar("scripted", clock=lambda: 100.0)
    driver._open_port = port.opened
    assert driver.poll() == []
    assert driver.reason == "the laser reports the error 0x8001"
    assert port.written[-1] == request(0x40)
