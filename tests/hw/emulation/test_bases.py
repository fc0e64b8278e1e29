"""The drivers of bases and their emulators were written by the manuals alone: they understand each other."""

import math
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from robbie_robots.hw.connected_base import BaseReading, ConnectedBase
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.p2os import EmulatedPioneer, PioneerState
from robbie_robots.hw.emulation.stepped_line import SteppedLine, SteppedTime
from robbie_robots.hw.irobot.create import CreateBase
from robbie_robots.hw.pioneer.base import PioneerBase

LIMIT_S = 30.0
BASES = pytest.mark.parametrize(
    ("emulated", "driver"), [(EmulatedCreate, CreateBase), (EmulatedPioneer, PioneerBase)]
)


def until(
    base: ConnectedBase, is_reached: Callable[[BaseReading], bool], drive: tuple[float, float] = (0.0, 0.0)
) -> BaseReading:
    """Drive until a reading is as it should be, and return it."""
    give_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up_s:
        for reading in base.poll(0.05):
            if is_reached(reading):
                return reading
        if any(drive) and base.is_connected:
            base.command(*drive, 0.5)
    raise AssertionError(f"not reached: {base.reason}")


@BASES
def test_base_drives_as_commanded_and_tells_it(
    emulated: type[EmulatedDevice], driver: Callable[[str], ConnectedBase], tmp_path: Path
) -> None:
    with (
        EmulatedLine(emulated(), PseudoTerminal(tmp_path / "base")) as line,
        closing(driver(line.url)) as base,
    ):
        reading = until(
            base,
            lambda one: (
                one.state.linear_m_per_s == pytest.approx(0.2, rel=0.1)
                and one.state.angular_rad_per_s == pytest.approx(0.3, rel=0.1)
            ),
            (0.2, 0.3),
        )
        assert reading.battery is not None and 12.0 < reading.battery.voltage_v < 16.0
        until(base, lambda one: one.state.pose.x_m > 0.1 and one.state.pose.y_m > 0.0, (0.2, 0.3))
        # No further command: it expires.
        until(base, lambda one: one.state.linear_m_per_s == 0.0)


@BASES
def test_base_that_is_pulled_out_is_back_within_two_seconds(
    emulated: type[EmulatedDevice], driver: Callable[[str], ConnectedBase], tmp_path: Path
) -> None:
    with (
        EmulatedLine(emulated(), PseudoTerminal(tmp_path / "base")) as line,
        closing(driver(line.url)) as base,
    ):
        until(base, lambda _: True)
        for _ in range(3):
            line.unplug()
            give_up_s = time.monotonic() + LIMIT_S
            while base.is_connected:
                assert time.monotonic() < give_up_s
                base.poll(0.05)
            line.plug_in()
            back_s = time.monotonic()
            until(base, lambda _: True)
            assert time.monotonic() - back_s < 2.0


@BASES
def test_base_on_a_line_with_faults_still_tells_where_it_is(
    emulated: type[EmulatedDevice], driver: Callable[[str], ConnectedBase], tmp_path: Path
) -> None:
    with (
        EmulatedLine(emulated(), PseudoTerminal(tmp_path / "base")) as line,
        closing(driver(line.url)) as base,
    ):
        until(base, lambda _: True)
        line.faults = Faults(cut_share=0.05, bit_error_rate=2e-4, noise_share=0.1)
        for _ in range(20):
            reading = until(base, lambda _: True)
            assert abs(reading.state.pose.x_m) < 0.01


@pytest.mark.parametrize("wanted", [(1.2, 0.0), (0.0, 3.0), (-0.8, 1.0)])
def test_pioneer_stands_within_0_4_s_after_its_line_broke(wanted: tuple[float, float]) -> None:
    clock = SteppedTime()
    device = EmulatedPioneer(EmulatedClock(monotonic=clock), PioneerState(bit_rate=57_600, watchdog_s=0.15))
    line = SteppedLine(device, clock)
    with closing(PioneerBase("simulated", 57_600, clock=clock, monotonic=clock)) as base:
        base._open_port = line.opened
        began_s = clock.now_s
        while clock.now_s < began_s + 3.0:
            base.command(*wanted, 0.3)
            base.poll(0.02)
        driven = device.velocity
        # From here on the robot hears nothing.
        broke_s = clock.now_s
        while device.velocity != (0.0, 0.0):
            line.read(0.001)
            assert clock.now_s - broke_s <= 0.4
    # It drove as fast as it may.
    assert max(abs(driven[0]) / 400, abs(driven[1]) / 60) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("wanted", [(0.4, 0.0), (0.0, 1.0), (-0.3, 0.5)])
def test_odometry_has_what_a_pioneer_drove_while_its_line_was_broken(wanted: tuple[float, float]) -> None:
    clock = SteppedTime()
    device = EmulatedPioneer(EmulatedClock(monotonic=clock), PioneerState(bit_rate=57_600, watchdog_s=0.15))
    line = SteppedLine(device, clock)
    with closing(PioneerBase("simulated", 57_600, clock=clock, monotonic=clock)) as base:
        base._open_port = line.opened
        while not base.poll(0.02):
            pass
        began_s = clock.now_s
        while clock.now_s < began_s + 2.0:
            base.command(*wanted, 0.3)
            base.poll(0.02)
        heard = base.read().pose
        base._lose(OSError("pulled out"))
        while device.velocity != (0.0, 0.0):
            line.read(0.001)
        clock.now_s += 1.0
        while not base.poll(0.02):
            pass
        pose = base.read().pose
    assert math.dist(heard[:2], pose[:2]) > 0.05 or abs(heard.heading_rad - pose.heading_rad) > 0.1
    assert pose[:2] == pytest.approx((device._x_mm / 1000, device._y_mm / 1000), abs=0.003)
    assert pose.heading_rad == pytest.approx(device._heading_rad, abs=0.005)
