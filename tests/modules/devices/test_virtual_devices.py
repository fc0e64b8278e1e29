"""A simulated device reports the values that you set by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.messages import BatteryState, Bumper, LaserScan
from robbie_robots.hw.simulation.laser import LaserFailure
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.battery import SimulatedBatteryModule
from robbie_robots.modules.devices.bumper import SimulatedBumperModule
from robbie_robots.modules.devices.laser import SimulatedLaserRangeFinder
from tests.modules.devices.test_simulated_devices import ARENA, drive, tell


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, object]:
    (tmp_path / "arena.yaml").write_text(ARENA)
    return {"arena": tmp_path / "arena.yaml"}


def test_laser_fails_as_set_and_recovers(settings: dict[str, object]) -> None:
    with (
        ModuleHarness(SimulatedBase, settings) as base,
        ModuleHarness(SimulatedLaserRangeFinder, settings | {"noise_m": 0.0}) as laser,
    ):
        ahead = {}
        for failure in (*LaserFailure, LaserFailure.NONE):
            laser.change_setting("virtual_failure", str(failure))
            drive(base, 1.0, 0.2)
            tell(base, laser)
            laser.advance(0.1)
            ahead[failure] = [scan.ranges[180] for scan in laser.take(LaserScan)]
            if failure is not LaserFailure.NONE:
                assert f"failure: {failure}" in laser.module.status
    assert ahead[LaserFailure.SILENT] == []
    assert np.isinf(ahead[LaserFailure.BLIND]).all()
    assert len(set(ahead[LaserFailure.FROZEN])) == 1
    assert np.isfinite(ahead[LaserFailure.NONE]).all()


def test_frozen_laser_repeats_its_last_sweep_with_new_stamps(settings: dict[str, object]) -> None:
    with (
        ModuleHarness(SimulatedBase, settings) as base,
        ModuleHarness(SimulatedLaserRangeFinder, settings) as laser,
    ):
        scans = []
        for failure in (LaserFailure.NONE, LaserFailure.FROZEN):
            laser.change_setting("virtual_failure", str(failure))
            drive(base, 1.0, 0.2)
            tell(base, laser)
            laser.advance(0.1)
            scans.append(laser.take(LaserScan)[-1])
    assert np.array_equal(scans[0].ranges, scans[1].ranges)
    assert scans[0].header.stamp.nanoseconds < scans[1].header.stamp.nanoseconds


def test_battery_is_drained_from_the_charge_that_was_set(settings: dict[str, object]) -> None:
    with (
        ModuleHarness(SimulatedBase, settings) as base,
        ModuleHarness(SimulatedBatteryModule, settings | {"capacity_ah": 0.02}) as battery,
    ):
        with pytest.raises(SettingError):
            battery.change_setting("virtual_charge", 1.5)
        battery.change_setting("virtual_charge", 0.3)
        battery.advance(1.0)
        without_base = battery.take(BatteryState, "battery")[-1]
        drive(base, 4.0, 0.0)
        tell(base, battery)
        battery.advance(1.0)
        drained = battery.take(BatteryState, "battery")[-1]
    assert without_base.percentage == pytest.approx(0.3)
    assert 0.0 < drained.percentage < 0.3
    assert math.isfinite(drained.voltage)


def test_bumper_can_be_pressed_manually_even_without_a_base(settings: dict[str, object]) -> None:
    with ModuleHarness(SimulatedBumperModule, settings) as bumper:
        bumper.advance(0.1)
        assert not bumper.published
        with pytest.raises(SettingError):
            bumper.change_setting("virtual_pressed", ["roof"])
        bumper.change_setting("virtual_pressed", ["front_right", "back_left"])
        bumper.advance(0.1)
        assert bumper.take(Bumper, "bumper")[-1].pressed == ["back_left", "front_right"]
        bumper.change_setting("virtual_pressed", [])
        bumper.advance(0.1)
        assert not bumper.published
