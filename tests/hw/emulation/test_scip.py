"""An emulated Hokuyo answers as its maker's specification says, and the driver understands it."""

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.device import EmulatedClock
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.scip import UTM_30LX, EmulatedHokuyo, checksum, coded
from robbie_robots.hw.emulation.stepped_line import SteppedTime
from robbie_robots.hw.hokuyo.laser import HokuyoLaser, SentMeasurements

WALL_M = np.linspace(0.5, 5.5, len(UTM_30LX.angles_rad()))
WALL_M[100], WALL_M[200], WALL_M[300] = math.inf, 0.001, 70.0


def heard(laser: EmulatedHokuyo, text: str) -> str:
    """Return what the laser answers to some text."""
    laser.receive(text.encode())
    return b"".join(laser.taken()).decode()


@pytest.mark.parametrize(("number", "text"), [(1234, "CB"), (5432, "1Dh"), (16_000_000, "m2@0")])
def test_numbers_are_coded_as_in_the_specification(number: int, text: str) -> None:
    assert coded(number, len(text)) == text


@pytest.mark.parametrize(("text", "told"), [("Hokuyo", "o"), ("00", "P"), ("99", "b"), ("02", "R")])
def test_checksums_are_those_of_the_specification(text: str, told: str) -> None:
    assert checksum(text) == told


def test_laser_switches_on_once_and_refuses_what_it_cannot_do() -> None:
    laser = EmulatedHokuyo(UTM_30LX, lambda _: WALL_M)
    assert heard(laser, "GD0000108000\n").split("\n")[1][:2] == "10"
    assert heard(laser, "BM\nBM\n") == "BM\n00P\n\nBM\n02R\n\n"
    assert heard(laser, "MD0000200000000\n").split("\n")[1][:2] == "04"
    assert heard(laser, "XY\n").split("\n")[1][:2] == "0E"


def test_asked_number_of_sweeps_counts_down_and_ends() -> None:
    laser = EmulatedHokuyo(UTM_30LX, lambda _: WALL_M)
    heard(laser, "MD0000001001002\n")
    sent = []
    while (due_s := laser.step()) is not None:
        laser.clock.set(due_s)
        sent += laser.taken()
    sent += laser.taken()
    assert [frame[:15] for frame in sent] == [b"MD0000001001001", b"MD0000001001000"]


def test_sweep_whose_ranges_are_known_late_keeps_its_stamp() -> None:
    clock, known = SteppedTime(), []
    laser = EmulatedHokuyo(
        UTM_30LX, lambda _: WALL_M, EmulatedClock(monotonic=clock), lambda at_s: at_s in known
    )
    heard(laser, "MD0000001001001\n")
    began_s = clock.now_s
    clock.now_s += 0.1
    assert laser.step() is not None and not laser.sent()
    known.append(began_s)
    laser.step()
    (frame,) = laser.sent()
    assert frame.at_s == pytest.approx(UTM_30LX.latency_s)
    assert frame.data.decode().split("\n")[2][:4] == coded(0, 4)


@pytest.mark.parametrize("data", SentMeasurements)
def test_driver_reads_what_the_laser_measures(data: SentMeasurements, tmp_path: Path) -> None:
    device = EmulatedHokuyo(UTM_30LX, lambda _: WALL_M)
    with (
        EmulatedLine(device, PseudoTerminal(tmp_path / "laser")) as line,
        closing(HokuyoLaser(line.url, silence_s=10.0, data=data)) as laser,
    ):
        sweep = laser.scan()
        most_m = 4.095 if data is SentMeasurements.SHORT_RANGES else 60.0
        seen = np.isfinite(sweep.ranges_m)
        expected = (WALL_M >= 0.023) & (most_m >= WALL_M)
        assert np.abs(sweep.ranges_m[expected] - WALL_M[expected]).max() <= 0.0006
        assert not seen[~expected & ~((most_m < WALL_M) & (WALL_M < 10.0))].any()
        assert (sweep.intensities is not None) == (data is SentMeasurements.INTENSITIES)
        assert laser.geometry.angle_min_rad == pytest.approx(-0.75 * math.pi)


def test_driver_merges_steps_and_goes_on_after_damage(tmp_path: Path) -> None:
    device = EmulatedHokuyo(UTM_30LX, lambda _: WALL_M)
    faults = Faults(cut_share=0.2, noise_share=0.2)
    with (
        EmulatedLine(device, PseudoTerminal(tmp_path / "laser")) as line,
        closing(HokuyoLaser(line.url, silence_s=10.0, merge=3)) as laser,
    ):
        assert len(laser.scan().ranges_m) == 361
        line.faults = faults
        for _ in range(5):
            assert laser.scan().ranges_m[1] == pytest.approx(WALL_M[3:6].min(), abs=0.0006)
