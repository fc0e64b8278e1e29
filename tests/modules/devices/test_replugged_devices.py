"""Modules on emulated devices: messages are right, none comes while the plug is out, none is stale after."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from robbie_mp import Message, Module, ModuleHarness
from robbie_mp.messages import BatteryState, DeviceState, Imu, LaserScan, NavSatFix
from robbie_robots.hw.emulation.carrier import Carrier, PseudoTerminal, TcpPort
from robbie_robots.hw.emulation.cola import LMS_111, TIM_561, EmulatedSickScanner
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.gnss import EmulatedNmea, EmulatedUblox
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.lms2xx import EmulatedLms2xx
from robbie_robots.hw.emulation.p2os import EmulatedPioneer
from robbie_robots.hw.emulation.rplidar import A1, A3, EmulatedRpLidar, RpLidarModel
from robbie_robots.hw.emulation.xsens import EmulatedMti
from robbie_robots.modules.devices.connected_base import CreateModule, PioneerModule
from robbie_robots.modules.devices.gnss import NmeaReceiverModule, UbxReceiverModule
from robbie_robots.modules.devices.rplidar import RpLidarRangeFinder
from robbie_robots.modules.devices.sick_cola import SickColaRangeFinder
from robbie_robots.modules.devices.sick_lms2xx import SickLms2xxRangeFinder
from robbie_robots.modules.devices.xsens import XsensModule

LIMIT_S = 60.0
LOOK_S = 0.1
# Number of times that a test checks that an unplugged device delivers nothing.
LOOKS = 5


class World:
    """What lasers see all around, m."""

    range_m = 0.0


class Trial(NamedTuple):
    """A module and its device.

    Attributes:
        module: the module.
        settings: its settings besides the port.
        emulated: makes the device in a world.
        show: lets the device measure a value.
        message: what the module publishes of it.
        read: finds the value in a message.
        values: two values.
    """

    module: type[Module]
    settings: dict[str, object]
    emulated: Callable[[World], EmulatedDevice]
    show: Callable[[Any, World, float], None]
    message: type[Message]
    read: Callable[[Any], float]
    values: tuple[float, float] = (2.0, 3.0)


def _laser(
    module: type[Module], emulated: Callable[[World], EmulatedDevice], settings: dict[str, object]
) -> Trial:
    def show(_device: object, world: World, value: float) -> None:
        world.range_m = value

    def read(scan: LaserScan) -> float:
        seen = scan.ranges[np.isfinite(scan.ranges)]
        assert len(seen) and np.allclose(seen, seen[0], atol=0.006)
        return float(seen[0])

    return Trial(module, settings, emulated, show, LaserScan, read)


def _lms2xx(world: World) -> EmulatedDevice:
    return EmulatedLms2xx(lambda _, angles: np.full(len(angles), world.range_m))


def _cola(is_text: bool) -> Callable[[World], EmulatedDevice]:
    model = LMS_111 if is_text else TIM_561
    return lambda world: EmulatedSickScanner(lambda _: np.full(model.beams, world.range_m), model, is_text)


def _rplidar(model: RpLidarModel) -> Callable[[World], EmulatedDevice]:
    return lambda world: EmulatedRpLidar(lambda _, angles: np.full(len(angles), world.range_m), model)


def _latitude(device: EmulatedNmea, _world: World, value: float) -> None:
    device.fix.latitude_deg = value


def _create_volts(device: EmulatedCreate, _world: World, value: float) -> None:
    device.sensors[22] = round(value * 1000)


def _pioneer_volts(device: EmulatedPioneer, _world: World, value: float) -> None:
    device.base.battery_v = value


def _turn(device: EmulatedMti, _world: World, value: float) -> None:
    device.motion.turn = (value, 0.0, 0.0)


def _volts(message: BatteryState) -> float:
    return message.voltage


TRIALS = {
    "lms2xx": _laser(SickLms2xxRangeFinder, _lms2xx, {"bit_rate": 500_000}),
    "cola-a": _laser(SickColaRangeFinder, _cola(True), {"dialect": "A"}),
    "cola-b": _laser(SickColaRangeFinder, _cola(False), {}),
    "rplidar": _laser(RpLidarRangeFinder, _rplidar(A1), {}),
    "rplidar-ultra": _laser(RpLidarRangeFinder, _rplidar(A3), {"bit_rate": 256_000, "mode": "ultra"}),
    "create": Trial(
        CreateModule, {}, lambda _: EmulatedCreate(), _create_volts, BatteryState, _volts, (14.5, 13.0)
    ),
    "pioneer": Trial(
        PioneerModule, {}, lambda _: EmulatedPioneer(), _pioneer_volts, BatteryState, _volts, (12.5, 11.5)
    ),
    "nmea": Trial(
        NmeaReceiverModule,
        {},
        lambda _: EmulatedNmea(bit_rate=4800, period_s=0.2),
        _latitude,
        NavSatFix,
        lambda fix: float(fix.latitude),
    ),
    "ubx": Trial(
        UbxReceiverModule,
        {},
        lambda _: EmulatedUblox(),
        _latitude,
        NavSatFix,
        lambda fix: float(fix.latitude),
    ),
    "xsens": Trial(
        XsensModule, {}, lambda _: EmulatedMti(), _turn, Imu, lambda imu: float(imu.angular_velocity.x)
    ),
}


def until(harness: ModuleHarness[Any], is_reached: Callable[[], object]) -> None:
    """Let the module look at its device until something is so."""
    give_up_s = time.monotonic() + LIMIT_S
    while not is_reached():
        assert time.monotonic() < give_up_s, harness.module.status
        harness.advance(LOOK_S)


DIRTY = {"lms2xx": (0x90, 0x10), "cola-a": (2, 0), "cola-b": (5, 0)}
"""The status with which each scanner reports dirt before it, and its usual one."""


@pytest.mark.parametrize("name", DIRTY)
def test_laser_that_reports_a_dirty_screen_is_degraded_until_it_is_clean(name: str, tmp_path: Path) -> None:
    trial, world = TRIALS[name], World()
    device: Any = trial.emulated(world)
    carrier: Carrier = TcpPort() if name.startswith("cola") else PseudoTerminal(tmp_path / "device")
    device.status, usual = DIRTY[name]
    with EmulatedLine(device, carrier) as line:
        settings = {"port": line.url, "silence_s": 30.0, "period_s": LOOK_S} | trial.settings
        with ModuleHarness(trial.module, settings) as harness:
            until(harness, lambda: "clean it" in harness.module.degraded)
            assert harness.take(LaserScan), "a dirty laser still measures"
            device.status = usual
            until(harness, lambda: not harness.module.degraded)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRIALS)
def test_device_is_read_pulled_out_and_plugged_in_again(name: str, tmp_path: Path) -> None:
    trial, world = TRIALS[name], World()
    device = trial.emulated(world)
    before, after = trial.values
    carrier: Carrier = TcpPort() if name.startswith("cola") else PseudoTerminal(tmp_path / "device")
    trial.show(device, world, before)
    received: list[Message] = []
    states: list[DeviceState] = []

    def look() -> list[Message]:
        received[:] = harness.take(trial.message)
        states.extend(harness.take(DeviceState))
        return received

    with EmulatedLine(device, carrier) as line:
        # Some forget it when they are switched on.
        trial.show(device, world, before)
        settings = {"port": line.url, "silence_s": 30.0, "period_s": LOOK_S} | trial.settings
        with ModuleHarness(trial.module, settings) as harness:
            until(harness, look)
            assert {round(trial.read(message), 1) for message in received} == {before}
            assert states[-1].state == "CONNECTED" and states[-1].connections == 1

            line.unplug()
            until(harness, lambda: look() is not None and states[-1].state == "DISCONNECTED")
            assert states[-1].losses == 1 and states[-1].reason
            trial.show(device, world, after)
            for _ in range(LOOKS):
                harness.advance(LOOK_S)
                assert look() == []

            line.plug_in()
            until(harness, look)
            assert {round(trial.read(message), 1) for message in received} == {after}
            until(harness, lambda: look() is not None and states[-1].state == "CONNECTED")
            assert states[-1].connections == 2
            assert "lost 1 times" in harness.module.status
