"""Every driver on its emulated device, whose plug is pulled again and again."""

import random
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from robbie_robots.hw.connection.device import PluggableDevice
from robbie_robots.hw.dynamixel.protocol1_joints import Protocol1Joint, Protocol1Joints
from robbie_robots.hw.dynamixel.servos import DynamixelJoints, ServoJoint
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.cola import LMS_111, TIM_561, EmulatedSickScanner
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.dynamixel import EmulatedServos
from robbie_robots.hw.emulation.dynamixel1 import AX_12, EmulatedOldServos
from robbie_robots.hw.emulation.gnss import EmulatedNmea, EmulatedUblox
from robbie_robots.hw.emulation.lcus import EmulatedRelays
from robbie_robots.hw.emulation.line import EmulatedLine
from robbie_robots.hw.emulation.lms2xx import EmulatedLms2xx
from robbie_robots.hw.emulation.mip import EmulatedMip
from robbie_robots.hw.emulation.p2os import EmulatedPioneer, PioneerState
from robbie_robots.hw.emulation.ptu import EmulatedPtu
from robbie_robots.hw.emulation.rplidar import A1, A3, S2, EmulatedRpLidar, RpLidarModel
from robbie_robots.hw.emulation.scip import UTM_30LX, EmulatedHokuyo
from robbie_robots.hw.emulation.xsens import EmulatedMti
from robbie_robots.hw.flir.ptu import FlirPanTilt
from robbie_robots.hw.gnss.receiver import NMEA_BIT_RATE, NmeaReceiver, UbxReceiver
from robbie_robots.hw.hokuyo.laser import HokuyoLaser
from robbie_robots.hw.irobot.create import CreateBase
from robbie_robots.hw.lctech.relays import RelayLights
from robbie_robots.hw.microstrain.imu import MicroStrainImu
from robbie_robots.hw.pioneer.base import PioneerBase
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.hw.sick.cola import Dialect
from robbie_robots.hw.sick.cola_laser import SickColaLaser
from robbie_robots.hw.sick.lms2xx import SickLms2xx
from robbie_robots.hw.xsens.imu import XsensImu

LIMIT_S = 20.0
WALL_M = np.linspace(0.5, 9.5, len(UTM_30LX.angles_rad()))


@dataclass(frozen=True)
class DriverTrial:
    """A device and its driver.

    Attributes:
        emulated: makes the device.
        driver: makes the driver for a port.
        move: has the device move; None: it cannot.
        stands: whether the device stands; None: it never moves, or nothing in it stops it.
    """

    emulated: Callable[[], EmulatedDevice]
    driver: Callable[[str], PluggableDevice[Any]]
    move: Callable[[Any], None] | None = None
    stands: Callable[[Any], bool] | None = None


def _rplidar(model: RpLidarModel, mode: str) -> DriverTrial:
    return DriverTrial(
        lambda: EmulatedRpLidar(lambda _, angles: 3 + np.cos(angles), model),
        lambda url: RpLidar(url, bit_rate=model.bit_rate, mode=mode),
    )


TRIALS = {
    "create": DriverTrial(EmulatedCreate, CreateBase, lambda base: base.command(0.2, 0.0, 5.0)),
    "pioneer": DriverTrial(
        lambda: EmulatedPioneer(base=PioneerState(watchdog_s=0.2)),
        PioneerBase,
        lambda base: base.command(0.2, 0.0, 5.0),
        lambda device: device.velocity == (0.0, 0.0),
    ),
    "hokuyo": DriverTrial(lambda: EmulatedHokuyo(UTM_30LX, lambda _: WALL_M), HokuyoLaser),
    "lms2xx": DriverTrial(
        lambda: EmulatedLms2xx(lambda _, angles: 3 + angles),
        lambda url: SickLms2xx(url, bit_rate=500_000, resolution_deg=1.0),
    ),
    "cola-a": DriverTrial(
        lambda: EmulatedSickScanner(lambda _: 3 + TIM_561.angles_rad(), TIM_561, is_text=True),
        lambda url: SickColaLaser(url, dialect=Dialect.A),
    ),
    "cola-b": DriverTrial(
        lambda: EmulatedSickScanner(lambda _: 3 + LMS_111.angles_rad(), LMS_111),
        lambda url: SickColaLaser(url, intensities=True),
    ),
    "rplidar": _rplidar(A1, "standard"),
    "rplidar-express": _rplidar(A3, "express"),
    "rplidar-ultra": _rplidar(A3, "ultra"),
    "rplidar-hq": _rplidar(A3, "hq"),
    "rplidar-dense": _rplidar(S2, "dense"),
    "xsens": DriverTrial(EmulatedMti, lambda url: XsensImu(url, 400)),
    "mip": DriverTrial(EmulatedMip, lambda url: MicroStrainImu(url, 500)),
    "nmea": DriverTrial(lambda: EmulatedNmea(bit_rate=NMEA_BIT_RATE, period_s=0.1), NmeaReceiver),
    "ubx": DriverTrial(EmulatedUblox, lambda url: UbxReceiver(url, period_s=0.1)),
    "ptu": DriverTrial(EmulatedPtu, FlirPanTilt),
    "lcus": DriverTrial(EmulatedRelays, lambda url: RelayLights(url, ["headlight", "rear light"])),
    "dynamixel": DriverTrial(
        lambda: EmulatedServos(range(1, 7)),
        lambda url: DynamixelJoints(
            url, [ServoJoint(f"joint{number}", servo=number) for number in range(1, 7)], rate_hz=100.0
        ),
        lambda joints: joints.command({"joint1": 3.0 if random.random() < 0.5 else -3.0}, 5.0),
        lambda device: device.servos[1].is_halted or not device.servos[1].table[64],
    ),
    # Nothing stops these when their cable is pulled.
    "dynamixel1": DriverTrial(
        lambda: EmulatedOldServos(dict.fromkeys(range(1, 7), AX_12)),
        lambda url: Protocol1Joints(
            url, [Protocol1Joint(f"joint{number}", servo=number) for number in range(1, 7)], rate_hz=50.0
        ),
        lambda joints: joints.command({"joint1": 2.0 if random.random() < 0.5 else -2.0}, 5.0),
    ),
}


@dataclass(frozen=True)
class Replugs:
    """The result of one device's replugs.

    Attributes:
        back_s: time from each plugging in to the next measurement.
        stands_s: time from each pulling until the device stood; empty if it does not move, or nothing in it
            stops it.
    """

    back_s: list[float]
    stands_s: list[float]


@contextmanager
def connected(trial: DriverTrial, folder: Path) -> Iterator[tuple[EmulatedLine, PluggableDevice[Any]]]:
    """Plug a device in, and wait for its first measurement."""
    with (
        EmulatedLine(trial.emulated(), PseudoTerminal(folder / "device")) as line,
        closing(trial.driver(line.url)) as driver,
    ):
        _until(driver, bool)
        yield line, driver


def replug(trial: DriverTrial, rounds: int, folder: Path, seed: int = 0) -> Replugs:
    """Pull the plug again and again, at random moments."""
    chance = random.Random(seed)
    back_s, stands_s = [], []
    with connected(trial, folder) as (line, driver):
        for _ in range(rounds):
            leave_s = time.monotonic() + chance.uniform(0.1, 0.3)
            while time.monotonic() < leave_s:
                if trial.move is not None:
                    trial.move(driver)
                driver.poll(0.02)
            line.unplug()
            watch = _Watch(trial.stands, line.device)
            _until(driver, lambda _: not driver.is_connected)
            stands_s += watch.result_s()
            leave_s = time.monotonic() + chance.uniform(0.0, 1.0)
            while time.monotonic() < leave_s:
                driver.poll(0.02)
            line.plug_in()
            plugged_s = time.monotonic()
            _until(driver, bool)
            back_s.append(time.monotonic() - plugged_s)
    return Replugs(back_s, stands_s)


class _Watch:
    """Looks in a thread when a device stands: the driver may be busy with the lost port meanwhile."""

    def __init__(self, stands: Callable[[Any], bool] | None, device: EmulatedDevice) -> None:
        self._stands, self._device = stands, device
        self._began_s, self._stood_s = time.monotonic(), [0.0]
        self._thread = Thread(target=self._look)
        self._thread.start()

    def result_s(self) -> list[float]:
        """Return how long it took; nothing if nobody can tell."""
        self._thread.join()
        return [] if self._stands is None else self._stood_s

    def _look(self) -> None:
        while self._stands is not None and not self._stands(self._device):
            _check(self._began_s + LIMIT_S)
            time.sleep(0.002)
        self._stood_s = [time.monotonic() - self._began_s]


def _until(driver: PluggableDevice[Any], is_reached: Callable[[list[Any]], bool]) -> None:
    limit_s = time.monotonic() + LIMIT_S
    while not is_reached(driver.poll(0.02)):
        _check(limit_s)


def _check(limit_s: float) -> None:
    if time.monotonic() > limit_s:
        raise TimeoutError(f"the device did not do what it should within {LIMIT_S:g} s")
