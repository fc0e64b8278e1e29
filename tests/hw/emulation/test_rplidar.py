"""An emulated RPLidar answers as its maker's document says; the driver and others' client understand it."""

import math
import struct
import time
from contextlib import closing
from itertools import pairwise

import numpy as np
import pyrplidar_protocol as witness
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.emulation.device import EmulatedClock
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.rplidar import A1, A3, S2, EmulatedRpLidar, RpLidarModel
from robbie_robots.hw.emulation.stepped_line import SteppedLine, SteppedTime
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.hw.rplidar.streams import CapsuleReader, DenseReader, Samples, StreamReader, UltraReader

Array = NDArray[np.float64]

MODES = [
    (A1, "standard", "Standard"),
    (A1, "express", "Express"),
    (A3, "typical", "Sensitivity"),
    (A3, "express", "Express"),
    (A3, "ultra", "Boost"),
    (A3, "sensitivity", "Sensitivity"),
    (A3, "hq", "HQ"),
    (S2, "standard", "Standard"),
    (S2, "dense", "DenseBoost"),
    (S2, "typical", "DenseBoost"),
]


def room(_turns: NDArray[np.int64], clockwise: Array) -> Array:
    """Return a round wall that is not centred, 0.6 to 9.4 m away, and nothing behind on the right."""
    ranges = 5 + 4.4 * np.cos(clockwise)
    return np.where(np.abs(clockwise - 2.2) < 0.3, np.inf, ranges)


def inside(is_so: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where something is so for two more sectors on both sides."""
    found: NDArray[np.bool_] = np.all([np.roll(is_so, by) for by in range(-2, 3)], axis=0)
    return found


def connected(model: RpLidarModel, mode: str) -> tuple[EmulatedRpLidar, SteppedLine, RpLidar]:
    clock = SteppedTime()
    device = EmulatedRpLidar(room, model, EmulatedClock(monotonic=clock))
    line = SteppedLine(device, clock)
    laser = RpLidar("simulated", clock=clock, bit_rate=model.bit_rate, mode=mode, beams=360, monotonic=clock)
    laser._open_port = line.opened
    return device, line, laser


@pytest.mark.parametrize(("model", "mode", "name"), MODES)
def test_driver_reads_what_the_laser_measures_in_each_mode(model: RpLidarModel, mode: str, name: str) -> None:
    device, _, laser = connected(model, mode)
    with closing(laser):
        sweeps = [laser.scan() for _ in range(3)]
        assert device.motor_pwm == 660
        assert laser.scan_mode is not None and laser.scan_mode.name == name
        assert laser.period_s == pytest.approx(1 / model.turns_per_s, rel=0.02)
        expected = room(np.zeros(360, np.int64), -laser.geometry.angles_rad() % (2 * math.pi))
        for sweep in sweeps:
            seen = np.isfinite(sweep.ranges_m)
            # A1's samples are 1 degree apart, so some sectors have none.
            assert seen[inside(np.isfinite(expected))].mean() > 0.6 if model is A1 else 0.95
            assert not seen[inside(np.isinf(expected))].any()
            both = seen & inside(np.isfinite(expected))
            # A sector holds the nearest of its samples.
            assert np.abs(sweep.ranges_m[both] - expected[both]).max() < 0.09
            assert (sweep.intensities is not None) == (name in ("Standard", "HQ"))


@pytest.mark.parametrize(
    ("model", "mode"), [(A1, "standard"), (A3, "express"), (A3, "ultra"), (A3, "hq"), (S2, "dense")]
)
def test_driver_reads_several_frames_at_once(
    model: RpLidarModel, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, line, laser = connected(model, mode)
    read, times_s = line.read, []

    def counted(wait_s: float) -> bytes:
        times_s.append(laser._clock())
        return read(wait_s)

    with closing(laser):
        laser.scan()
        monkeypatch.setattr(line, "read", counted)
        for _ in range(5):
            laser.scan()
        assert len(times_s) / (times_s[-1] - times_s[0]) < 400.0


def test_mode_that_the_laser_has_not_is_refused_and_the_others_are_told() -> None:
    _, _, laser = connected(S2, "ultra")
    give_up_s = time.monotonic() + 60.0
    # A busy machine may be too late for an answer.
    while not laser.reason.startswith("the laser has no scan mode"):
        assert laser.poll(0.1) == []
        assert time.monotonic() < give_up_s
    assert laser.reason == (
        "the laser has no scan mode 'ultra' that can be read; it has Standard (0x81), Standard (0x81), "
        "DenseBoost (0x85)"
    )


@pytest.mark.parametrize(
    ("model", "mode"), [(A1, "standard"), (A1, "express"), (A3, "ultra"), (A3, "hq"), (S2, "dense")]
)
def test_laser_on_a_line_with_faults_still_measures_the_room(model: RpLidarModel, mode: str) -> None:
    _, line, laser = connected(model, mode)
    with closing(laser):
        laser.scan()
        line.faults = Faults(bit_error_rate=1e-6, cut_share=0.0003, noise_share=0.0003)
        expected = room(np.zeros(360, np.int64), -laser.geometry.angles_rad() % (2 * math.pi))
        for _ in range(10):
            sweep = laser.scan()
            both = np.isfinite(sweep.ranges_m) & np.isfinite(expected)
            # Without a checksum a damaged sample of the standard mode may be wrong.
            assert np.median(np.abs(sweep.ranges_m[both] - expected[both])) < 0.04


def frames(model: RpLidarModel, number: int, count: int) -> list[bytes]:
    """Return frames of a laser's stream."""
    clock = SteppedTime()
    laser = EmulatedRpLidar(room, model, EmulatedClock(monotonic=clock))
    start = b"\xa5\x82\x05" + struct.pack("<BI", number, 0)
    check = 0
    for byte in start:
        check ^= byte
    laser.receive(start + bytes([check]))
    laser.taken()
    sent: list[bytes] = []
    while len(sent) < count:
        due_s = laser.step()
        sent += laser.taken()
        assert due_s is not None
        clock.now_s = max(laser.clock.true_s(due_s), clock.now_s + 1e-9)
    return sent[:count]


def judged(kind: type, sent: list[bytes]) -> tuple[list[float], list[float]]:
    """Return what pyrplidar, by other authors, makes of frames: directions and distances."""
    angles, distances = [], []
    for before, after in pairwise(sent):
        for node in kind._parse_capsule(kind(before), kind(after)):  # type: ignore[attr-defined]
            angles.append(node.get_angle())
            distances.append(node.get_distance())
    return angles, distances


def agrees(samples: Samples, angles: list[float], distances: list[float]) -> bool:
    """Return whether samples are the witness's, within the rounding of its integers."""
    away = np.abs((samples.angles_deg - np.array(angles) + 180) % 360 - 180)
    return bool(away.max() < 0.05 and np.array_equal(samples.distances_mm, distances))


@pytest.mark.parametrize(
    ("model", "number", "reader", "kind"),
    [
        (A3, 1, CapsuleReader, witness.PyRPlidarScanCapsule),
        (A3, 2, UltraReader, witness.PyRPlidarScanUltraCapsule),
    ],
)
def test_witness_reads_the_same_samples(
    model: RpLidarModel, number: int, reader: type[StreamReader], kind: type
) -> None:
    sent = frames(model, number, 60)
    assert agrees(reader().feed(b"".join(sent)), *judged(kind, sent))


def test_witness_reads_the_same_dense_samples_but_for_the_order_of_bytes() -> None:
    sent = frames(S2, 1, 60)
    # pyrplidar 0.1.2 takes the distances' high byte first; the maker's document says the low one.
    swapped = [one[:4] + np.frombuffer(one[4:], "<u2").astype(">u2").tobytes() for one in sent]
    assert agrees(DenseReader().feed(b"".join(sent)), *judged(witness.PyRPlidarScanDenseCapsule, swapped))


@pytest.mark.parametrize("seed", range(5))
def test_witness_reads_the_same_from_random_ultra_capsules(seed: int) -> None:
    chance = np.random.default_rng(seed)
    sent = []
    for start_deg in range(0, 200, 10):
        body = struct.pack("<H", start_deg * 64) + chance.bytes(128)
        check = int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))
        sent.append(bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body)
    samples = UltraReader().feed(b"".join(sent))
    _, distances = judged(witness.PyRPlidarScanUltraCapsule, sent)
    # A difference below no distance: the witness wraps it to more than a million kilometres.
    possible = np.array(distances) < 1e6
    assert np.array_equal(samples.distances_mm[possible], np.array(distances)[possible])
    assert not samples.distances_mm[~possible].any()
