"""What the simulated robot does becomes bytes of an emulated unit, and these become `Imu` messages."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.messages import DeviceState, Imu
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.emulated_imu import EmulatedImu, EmulatedMicroStrainImu, EmulatedXsensImu
from robbie_robots.modules.devices.microstrain import MicroStrainModule
from robbie_robots.modules.devices.pluggable_imu import PluggableImuModule
from robbie_robots.modules.devices.xsens import XsensModule
from tests.modules.devices.test_simulated_devices import ARENA, drive, tell

LIMIT_S = 20.0


def until(harness: ModuleHarness[PluggableImuModule], is_reached: Callable[[Imu], bool]) -> Imu:
    give_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up_s:
        harness.advance(0.005)
        for message in harness.take(Imu):
            if is_reached(message):
                return message
    raise AssertionError(harness.module.status)


@pytest.mark.parametrize(
    ("emulator", "driver"), [(EmulatedXsensImu, XsensModule), (EmulatedMicroStrainImu, MicroStrainModule)]
)
def test_turning_robot_is_measured_over_the_serial_line_also_after_a_replug(
    emulator: type[EmulatedImu], driver: type[PluggableImuModule], tmp_path: Path
) -> None:
    (tmp_path / "arena.yaml").write_text(ARENA)
    settings = {"arena": tmp_path / "arena.yaml"}
    with (
        ModuleHarness(SimulatedBase, settings, name="base") as base,
        ModuleHarness(emulator, settings, name="imu_emulator", output_directory=tmp_path) as unit,
        ModuleHarness(driver, {"port": "run:imu_emulator"}, name="imu", output_directory=tmp_path) as harness,
    ):
        resting = until(harness, lambda _: True)
        assert resting.angular_velocity.z == 0.0
        assert resting.linear_acceleration.z == pytest.approx(9.81, abs=0.01)
        drive(base, 1.0, 0.0, 0.5)
        truth = tell(base, unit).pose.pose.orientation.yaw
        turning = until(harness, lambda imu: imu.angular_velocity.z > 0.4)
        assert turning.linear_acceleration.z == pytest.approx(9.81, abs=0.5)
        until(harness, lambda imu: math.isclose(imu.orientation.yaw, truth, abs_tol=1e-3))
        unit.change_setting("virtual_plug", False)
        harness.take(DeviceState)
        while "DISCONNECTED" not in [state.state for state in harness.take(DeviceState)]:
            harness.advance(0.005)
        harness.take(Imu)
        harness.advance(0.01)
        assert harness.take(Imu) == []
        unit.change_setting("virtual_plug", True)
        until(harness, lambda imu: imu.angular_velocity.z > 0.4)
