"""Emulated bases, inertial units and receivers answer as their makers' manuals say."""

import math
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.emulation import create, fletcher, gnss, mip, p2os, xsens
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import MAX_LATE_S, EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.gnss import EmulatedNmea, EmulatedUblox
from robbie_robots.hw.emulation.mip import EmulatedMip
from robbie_robots.hw.emulation.p2os import EmulatedPioneer
from robbie_robots.hw.emulation.rplidar import EmulatedRpLidar
from robbie_robots.hw.emulation.scip import UTM_30LX, EmulatedHokuyo
from robbie_robots.hw.emulation.xsens import EmulatedMti


class Clock(EmulatedClock):
    """Stands still until it is moved."""

    def __init__(self) -> None:
        self.true = 0.0
        super().__init__(monotonic=lambda: self.true)


def heard(device: EmulatedDevice, hexadecimal: str) -> str:
    """Return what the device answers to some bytes."""
    device.receive(bytes.fromhex(hexadecimal))
    return b"".join(device.taken()).hex(" ").upper()


def after(device: EmulatedDevice, clock: Clock, passed_s: float) -> list[bytes]:
    """Return what the device sends by itself within a time."""
    for _ in range(round(passed_s / 0.005)):
        clock.true += 0.005
        device.step()
    return device.taken()


def test_create_streams_the_example_of_the_manual() -> None:
    clock = Clock()
    robot = EmulatedCreate(clock)
    robot.sensors |= {29: 549, 13: 0}
    assert heard(robot, "94 02 1D 0D") == ""  # off: it hears nothing but START
    heard(robot, "80 94 02 1D 0D")
    frames = after(robot, clock, 0.1)
    assert frames[0] == bytes.fromhex("13 05 1D 02 25 0D 00") + bytes(
        [-(0x13 + 5 + 0x1D + 2 + 0x25 + 0x0D) & 0xFF]
    )
    robot.sensors[29] = 0x0219
    assert after(robot, clock, 0.02)[-1] == bytes.fromhex("13 05 1D 02 19 0D 00 A3")
    assert 5 <= len(frames) <= 7


@pytest.mark.parametrize(
    ("group", "size"),
    [(0, 26), (1, 10), (2, 6), (3, 10), (4, 14), (5, 12), (6, 52), (100, 80), (101, 28), (106, 12), (107, 9)],
)
def test_groups_of_a_create_have_the_sizes_of_the_manual(group: int, size: int) -> None:
    robot = EmulatedCreate()
    assert len(bytes.fromhex(heard(robot, f"80 8E {group:02X}"))) == size


def test_create_drives_the_arc_of_the_manual_and_counts_it() -> None:
    clock = Clock()
    robot = EmulatedCreate(clock)
    heard(robot, "80 83 89 FF 38 01 F4")
    right, left = robot.speeds_mm_per_s
    assert (right + left) / 2 == pytest.approx(-200)
    assert (right - left) / 235 == pytest.approx(-200 / 500)
    after(robot, clock, 1.0)
    answer = bytes.fromhex(heard(robot, "95 04 2B 2C 13 14"))
    counts = struct.unpack(">hhhh", answer)
    assert counts[0] == pytest.approx(left / 1000 * 508.8 / (math.pi * 0.072), abs=5)
    assert counts[2] == pytest.approx(-200, abs=2)
    assert counts[3] == pytest.approx(math.degrees(-0.4), abs=2)


def test_create_in_safe_mode_stops_at_a_cliff_a_wheel_drop_and_on_its_dock() -> None:
    events: list[Callable[[EmulatedCreate], None]] = [
        lambda robot: robot.see_cliff(True),
        lambda robot: robot.press(0b0100),
        lambda robot: robot.charge(True),
    ]
    for event in events:
        robot = EmulatedCreate()
        heard(robot, "80 83 91 00 C8 00 C8")
        assert list(robot.speeds_mm_per_s) == [200, 200]
        event(robot)
        assert (robot.mode, *robot.speeds_mm_per_s) == (create.PASSIVE, 0, 0)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("00", "FA FB 03 00 00 00"),
        ("01", "FA FB 03 01 00 01"),
        ("02", "FA FB 03 02 00 02"),
        ("04 3B 01 00", "FA FB 06 04 3B 01 00 05 3B"),
        ("0B 3B C8 00", "FA FB 06 0B 3B C8 00 D3 3B"),
        ("0B 1B C8 00", "FA FB 06 0B 1B C8 00 D3 1B"),
        ("15 3B 1E 00", "FA FB 06 15 3B 1E 00 33 3B"),
        ("1C 3B 00 00", "FA FB 06 1C 3B 00 00 1C 3B"),
        ("37", "FA FB 03 37 00 37"),
    ],
)
def test_packets_of_a_pioneer_have_the_checksum_of_the_manual(body: str, told: str) -> None:
    assert p2os.packet(bytes.fromhex(body)) == bytes.fromhex(told)


def opened(clock: Clock) -> EmulatedPioneer:
    robot = EmulatedPioneer(clock)
    assert heard(robot, "FA FB 03 00 00 00") == "FA FB 03 00 00 00"
    assert heard(robot, "FA FB 03 01 00 01") == "FA FB 03 01 00 01"
    answer = bytes.fromhex(heard(robot, "FA FB 03 02 00 02"))
    assert answer[3:-2].split(b"\0")[:3] == [b"\x02Robot", b"Pioneer", b"p3at"]
    heard(robot, "FA FB 03 01 00 01")
    heard(robot, "FA FB 06 04 3B 01 00 05 3B")
    return robot


def test_pioneer_reports_where_it_drives_and_its_watchdog_stops_it() -> None:
    clock = Clock()
    robot = opened(clock)
    heard(robot, p2os.packet(bytes.fromhex("05 3B D0 07")).hex())
    heard(robot, p2os.packet(bytes.fromhex("05 1B D0 07")).hex())
    heard(robot, "FA FB 06 0B 3B C8 00 D3 3B")
    reports = after(robot, clock, 1.0)
    assert 9 <= len(reports) <= 11
    last = reports[-1]
    assert last[3] == 0x33 and p2os.checksum(last[3:-2]) == int.from_bytes(last[-2:], "big")
    x, _, _, left, right = struct.unpack_from("<HHhhh", last, 4)
    assert x * 0.465 == pytest.approx(200, abs=25)
    assert (left, right) == (200, 200)
    after(robot, clock, 1.5)
    assert (robot.velocity, robot.watchdog_stops) == ((0.0, 0.0), 1)


def test_pioneer_as_delivered_speeds_up_and_brakes_with_0_3_m_per_s2() -> None:
    clock = Clock()
    robot = opened(clock)
    heard(robot, "FA FB 06 0B 3B C8 00 D3 3B")
    after(robot, clock, 0.33)
    assert robot.velocity[0] == pytest.approx(100, abs=3)
    after(robot, clock, 0.5)
    assert robot.velocity == (200.0, 0.0)
    heard(robot, "FA FB 03 1D 00 1D")
    after(robot, clock, 0.33)
    assert robot.velocity[0] == pytest.approx(100, abs=3)
    heard(robot, "FA FB 03 37 00 37")
    assert robot.velocity == (0.0, 0.0)


def test_pioneer_tells_its_watchdog_and_accelerations_until_the_host_goes() -> None:
    clock = Clock()
    robot = opened(clock)

    def told() -> tuple[int, ...]:
        answer = bytes.fromhex(heard(robot, "FA FB 03 12 00 12"))
        assert answer[3] == 0x20
        behind = answer[4:].split(b"\0", 3)[3]
        numbers = struct.unpack_from("<B5H", behind)
        rest = behind[behind.index(b"\0", struct.calcsize("<B5H")) + 1 :]
        return (
            *numbers[3:5],
            *struct.unpack_from("<H", rest, 12),
            *struct.unpack_from("<10H", rest, 27)[::5],
        )

    assert told() == (300, 2000, 2000, 100, 300)
    heard(robot, p2os.packet(bytes.fromhex("05 3B E8 03")).hex())
    heard(robot, p2os.packet(bytes.fromhex("17 3B FF 7F")).hex())  # more than it can
    assert told() == (300, 2000, 2000, 300, 1000)
    heard(robot, "FA FB 03 02 00 02")
    for sync in ("00 00 00", "01 00 01", "02 00 02"):
        heard(robot, f"FA FB 03 {sync}")
    heard(robot, "FA FB 03 01 00 01")
    assert told() == (300, 2000, 2000, 100, 300)


@pytest.mark.parametrize("make", [EmulatedCreate, EmulatedPioneer])
def test_late_emulator_of_a_base_makes_up_for_every_report(
    make: Callable[[Clock], EmulatedDevice],
) -> None:
    clock = Clock()
    robot = make(clock)
    if isinstance(robot, EmulatedPioneer):
        robot = opened(clock)
        period_s = p2os.SIP_PERIOD_S
    else:
        heard(robot, "80 94 01 07")
        period_s = create.STREAM_PERIOD_S
    began_s = clock.true
    clock.true = began_s + 3.6 * period_s
    due_s = robot.step()
    sent_s = [robot.clock.true_s(frame.at_s) for frame in robot.sent() if frame.at_s is not None]
    assert sent_s == pytest.approx([began_s + beat * period_s for beat in (1, 2, 3)])
    assert due_s == pytest.approx(robot.clock.at_s(began_s + 4 * period_s))
    # After a long pause, such as that of a stopped process, it leaves out what is long over.
    clock.true = began_s + 100.3 * period_s
    robot.step()
    assert len(robot.taken()) == 100 - math.ceil(100.3 - MAX_LATE_S / period_s) + 1


def test_pioneer_ignores_a_command_with_a_wrong_checksum() -> None:
    robot = opened(Clock())
    heard(robot, "FA FB 06 0B 3B C8 00 D3 3C")
    assert robot.velocity == (0.0, 0.0)


def test_messages_of_an_mti_have_the_checksum_of_the_manual() -> None:
    told = {0x30: "FA FF 30 00 D1", 0x10: "FA FF 10 00 F1", 0x00: "FA FF 00 00 01", 0x40: "FA FF 40 00 C1",
            0x3F: "FA FF 3F 00 C2"}  # fmt: skip
    for kind, bytes_told in told.items():
        assert xsens.message(kind) == bytes.fromhex(bytes_told)
    assert sum(xsens.message(0x36, bytes(300))[1:]) & 0xFF == 0


def test_mti_is_configured_and_measures() -> None:
    clock = Clock()
    unit = EmulatedMti(clock)
    unit.taken()
    assert heard(unit, "FA FF 30 00 D1") == "FA FF 31 00 D0"
    assert after(unit, clock, 0.1) == []
    assert heard(unit, "FA FF 00 00 01").startswith("FA FF 01 04 01 23 45 67")
    unit.receive(xsens.message(xsens.SET_OUTPUT, struct.pack(">HHHH", 0x1060, 0xFFFF, 0x2010, 50)))
    unit.taken()
    heard(unit, "FA FF 10 00 F1")
    frames = after(unit, clock, 0.2)
    assert 9 <= len(frames) <= 12
    assert frames[0][4:11] == bytes.fromhex("10 60 04") + int(0.1 * 10_000).to_bytes(4, "big")
    assert struct.unpack(">4f", frames[0][14:30]) == (1.0, 0.0, 0.0, 0.0)


def test_mip_unit_answers_a_ping_and_streams() -> None:
    clock = Clock()
    unit = EmulatedMip(clock)
    unit.motion.acceleration = (1.0, 2.0, -3.0)
    unit.step()
    unit.taken()
    ping = "75 65 01 02 02 01 E0 C6"
    answer = bytes.fromhex(heard(unit, ping))
    assert answer[:8] == bytes.fromhex("75 65 01 04 04 F1 01 00")
    assert fletcher.fletcher(answer[:-2]) == answer[-2:]
    assert len(after(unit, clock, 0.1)) in (9, 10, 11)


def test_vector_of_a_mip_unit_is_that_of_the_manual() -> None:
    told = bytes.fromhex("75 65 80 0E 0E 04 3F 80 00 00 40 00 00 00 C0 40 00 00 79 ED")
    assert mip.packet(mip.SENSOR_DATA, [(mip.ACCELERATION, struct.pack(">3f", 1, 2, -3))]) == told


def test_sentences_and_frames_of_receivers_have_the_checksums_of_real_ones() -> None:
    gga = "GPGGA,184353.07,1929.045,S,02410.506,E,1,04,2.6,100.00,M,-33.9,M,,0000"
    assert gnss.sentence(gga) == f"${gga}*6D\r\n".encode()
    assert gnss.ubx(gnss.MON_VER) == bytes.fromhex("B5 62 0A 04 00 00 0E 34")
    rate = bytes.fromhex("64 00 01 00 00 00")
    assert gnss.ubx(gnss.CFG_RATE, rate) == bytes.fromhex("B5 62 06 08 06 00 64 00 01 00 00 00 79 10")


@given(st.floats(-90, 90), st.floats(-180, 180))
def test_receiver_tells_its_place_in_degrees_and_minutes(latitude: float, longitude: float) -> None:
    receiver = EmulatedNmea()
    receiver.fix.latitude_deg, receiver.fix.longitude_deg = latitude, longitude
    fields = receiver.frames(0.0)[0].decode().split(",")
    for text, letter, digits, value in (
        (fields[2], fields[3], 2, latitude),
        (fields[4], fields[5], 3, longitude),
    ):
        told = int(text[:digits]) + float(text[digits:]) / 60
        assert float(text[digits:]) < 60
        assert (-told if letter in "SW" else told) == pytest.approx(value, abs=1e-6)


def test_ublox_is_switched_to_nav_pvt() -> None:
    clock = Clock()
    receiver = EmulatedUblox(clock)
    receiver.step()
    assert all(frame.startswith(b"$GP") for frame in receiver.taken())
    assert heard(receiver, "B5 62 06 08 06 00 64 00 01 00 00 00 79 10").startswith("B5 62 05 01 02 00 06 08")
    for switch in ((0x01, 0x07, 1), (0xF0, 0x00, 0)):
        receiver.receive(gnss.ubx(gnss.CFG_MSG, bytes(switch)))
    receiver.taken()
    frames = after(receiver, clock, 2.0)
    payload = frames[-1][6:-2]
    assert len(payload) == 92 and payload[20] == 3 and payload[21] & 1
    longitude, latitude, _, altitude_mm = struct.unpack_from("<iiii", payload, 24)
    assert (longitude, latitude, altitude_mm) == (75_590_000, 503_630_000, 80_000)
    assert len(frames) > 8
    assert heard(receiver, gnss.ubx((0x06, 0x99)).hex()).startswith("B5 62 05 00 02 00 06 99")


@given(st.lists(st.binary(max_size=60), max_size=5))
def test_no_bytes_of_a_host_disturb_a_device(parts: list[bytes]) -> None:
    devices: list[EmulatedDevice] = [
        EmulatedCreate(),
        EmulatedPioneer(),
        EmulatedMti(),
        EmulatedMip(),
        EmulatedUblox(),
    ]
    for device in devices:
        for part in parts:
            device.receive(part)
            device.step()
        device.taken()


class BusyClock(EmulatedClock):
    """Passes 10 ms with each look at it, as on a machine that is too busy to make each frame in time."""

    LIMIT_S = 100.0

    def __init__(self) -> None:
        self.true = 0.0
        super().__init__(monotonic=self._look)

    def _look(self) -> float:
        self.true += 0.01
        assert self.true < self.LIMIT_S, "the step does not end"
        return self.true


@pytest.mark.parametrize(
    ("make", "start"),
    [
        (lambda clock: EmulatedCreate(clock=clock), b"\x80\x94\x01\x07"),
        (lambda clock: EmulatedMip(clock=clock), mip.packet(0x0C, [(0x08, bytes.fromhex("01 01 04 00 01"))])),
        (lambda clock: EmulatedNmea(period_s=0.005, clock=clock), b""),
        (lambda clock: EmulatedRpLidar(lambda _, angles: 1 + angles, clock=clock), b"\xa5\x20"),
        (
            lambda clock: EmulatedHokuyo(UTM_30LX, lambda _: np.ones(1081), clock),
            b"BM\nMD0000108000000\n",
        ),
    ],
    ids=["create", "mip", "nmea", "rplidar", "hokuyo"],
)
def test_device_on_a_busy_machine_sends_what_is_due_and_no_more(
    make: Callable[[EmulatedClock], EmulatedDevice], start: bytes
) -> None:
    device = make(BusyClock())
    device.receive(start)
    device.taken()
    for _ in range(20):
        device.step()
    assert device.taken()


def test_clock_of_a_device_is_set_and_drifts() -> None:
    clock = EmulatedClock(start_s=100.0, drift=0.5, monotonic=time.monotonic)
    now_s = clock.now_s()
    assert 100.0 <= now_s < 160.0
    assert clock.at_s(clock.true_s(130.0)) == pytest.approx(130.0)
