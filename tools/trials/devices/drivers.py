"""Drivers on emulated devices: plugs pulled under load, and processor time.

    python -m tools.trials drivers [DEVICE ...] [--rounds 50] [--load 2]
    python -m tools.trials drivers [DEVICE ...] --cost [--seconds 6]

The tool pulls each plug, waits, plugs in again and takes the time until the next measurement, while other
processes compute. It also takes the time until a moving device stands after its plug was pulled. With
`--cost`, it takes the processor time of the driver alone: its thread's.
"""

import argparse
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
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
from robbie_robots.hw.emulation.p2os import Base, EmulatedPioneer
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
from tools.trials.harness import Case, TrialSubject, names_of

LIMIT_S = 20.0
BACK_S, STANDS_S = 2.0, 0.4
WALL_M = np.linspace(0.5, 9.5, len(UTM_30LX.angles_rad()))


@dataclass(frozen=True)
class Trial:
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


def _rplidar(model: RpLidarModel, mode: str) -> Trial:
    return Trial(
        lambda: EmulatedRpLidar(lambda _, angles: 3 + np.cos(angles), model),
        lambda url: RpLidar(url, bit_rate=model.bit_rate, mode=mode),
    )


TRIALS = {
    "create": Trial(EmulatedCreate, CreateBase, lambda base: base.command(0.2, 0.0, 5.0)),
    "pioneer": Trial(
        lambda: EmulatedPioneer(base=Base(watchdog_s=0.2)),
        PioneerBase,
        lambda base: base.command(0.2, 0.0, 5.0),
        lambda device: device.velocity == (0.0, 0.0),
    ),
    "hokuyo": Trial(lambda: EmulatedHokuyo(UTM_30LX, lambda _: WALL_M), HokuyoLaser),
    "lms2xx": Trial(
        lambda: EmulatedLms2xx(lambda _, angles: 3 + angles),
        lambda url: SickLms2xx(url, bit_rate=500_000, resolution_deg=1.0),
    ),
    "cola-a": Trial(
        lambda: EmulatedSickScanner(lambda _: 3 + TIM_561.angles_rad(), TIM_561, is_text=True),
        lambda url: SickColaLaser(url, dialect=Dialect.A),
    ),
    "cola-b": Trial(
        lambda: EmulatedSickScanner(lambda _: 3 + LMS_111.angles_rad(), LMS_111),
        lambda url: SickColaLaser(url, intensities=True),
    ),
    "rplidar": _rplidar(A1, "standard"),
    "rplidar-express": _rplidar(A3, "express"),
    "rplidar-ultra": _rplidar(A3, "ultra"),
    "rplidar-hq": _rplidar(A3, "hq"),
    "rplidar-dense": _rplidar(S2, "dense"),
    "xsens": Trial(EmulatedMti, lambda url: XsensImu(url, 400)),
    "mip": Trial(EmulatedMip, lambda url: MicroStrainImu(url, 500)),
    "nmea": Trial(lambda: EmulatedNmea(bit_rate=NMEA_BIT_RATE, period_s=0.1), NmeaReceiver),
    "ubx": Trial(EmulatedUblox, lambda url: UbxReceiver(url, period_s=0.1)),
    "ptu": Trial(EmulatedPtu, FlirPanTilt),
    "lcus": Trial(EmulatedRelays, lambda url: RelayLights(url, ["headlight", "rear light"])),
    "dynamixel": Trial(
        lambda: EmulatedServos(range(1, 7)),
        lambda url: DynamixelJoints(
            url, [ServoJoint(f"joint{number}", servo=number) for number in range(1, 7)], rate_hz=100.0
        ),
        lambda joints: joints.command({"joint1": 3.0 if random.random() < 0.5 else -3.0}, 5.0),
        lambda device: device.servos[1].is_halted or not device.servos[1].table[64],
    ),
    # Nothing stops these when their cable is pulled.
    "dynamixel1": Trial(
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
def load(processes: int) -> Iterator[None]:
    """Keep processors busy with processes that have sessions of their own, as modules have."""
    command = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(command, start_new_session=True) for _ in range(processes)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@contextmanager
def connected(trial: Trial, folder: Path) -> Iterator[tuple[EmulatedLine, PluggableDevice[Any]]]:
    """Plug a device in, and wait for its first measurement."""
    with (
        EmulatedLine(trial.emulated(), PseudoTerminal(folder / "device")) as line,
        closing(trial.driver(line.url)) as driver,
    ):
        _until(driver, bool)
        yield line, driver


def replug(trial: Trial, rounds: int, folder: Path, seed: int = 0) -> Replugs:
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


@contextmanager
def served(trial: Trial, folder: Path) -> Iterator[str]:
    """Emulate a device in a process of its own; return the URL of its line."""

    def serve() -> None:
        with EmulatedLine(trial.emulated(), PseudoTerminal(folder / "device")):
            end.wait()

    context = get_context("fork")
    end = context.Event()
    process = context.Process(target=serve)
    process.start()
    try:
        yield str(folder / "device")
    finally:
        end.set()
        process.join()


def cost(trial: Trial, seconds: float, folder: Path) -> tuple[float, float]:
    """Return the share of a core that the driver takes, and its measurements each second.

    The device is emulated in another process, so that the driver does not wait for Python's lock, as little
    as in its module.
    """
    with served(trial, folder) as url, closing(trial.driver(url)) as driver:
        _until(driver, bool)
        count, began_s, began_cpu_s = 0, time.monotonic(), time.thread_time()
        while time.monotonic() < began_s + seconds:
            count += len(driver.poll(0.1))
        passed_s = time.monotonic() - began_s
        return (time.thread_time() - began_cpu_s) / passed_s, count / passed_s


def _until(driver: PluggableDevice[Any], is_reached: Callable[[list[Any]], bool]) -> None:
    limit_s = time.monotonic() + LIMIT_S
    while not is_reached(driver.poll(0.02)):
        _check(limit_s)


def _check(limit_s: float) -> None:
    if time.monotonic() > limit_s:
        raise TimeoutError(f"the device did not do what it should within {LIMIT_S:g} s")


def play(case: Case) -> dict[str, Any]:
    """Replug a device, or take the processor time of its driver."""
    chosen, device = case.options, TRIALS[case.kind]
    if chosen.cost:
        share, rate_hz = cost(device, chosen.seconds, case.folder)
        return {"device": case.kind, "share": round(share, 4), "rate_hz": round(rate_hz, 1)}
    with load(chosen.load):
        result = replug(device, chosen.rounds, case.folder, case.seed)
    times = {"back": result.back_s, "stands": result.stands_s}
    return {"device": case.kind, "replugs": len(result.back_s)} | {
        f"{what}_{name}_s": round(float(figure(values)), 2)
        for what, values in times.items()
        if values
        for name, figure in (("median", np.median), ("worst", max))
    }


def in_time(results: list[dict[str, Any]]) -> bool:
    """Return whether every device was back, and stood, in time."""
    limits = {"back_worst_s": BACK_S, "stands_worst_s": STANDS_S}
    return all(one.get(name, 0.0) <= limit_s for one in results for name, limit_s in limits.items())


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of devices."""
    parser.add_argument("devices", nargs="*", metavar="DEVICE", help=f"of {', '.join(TRIALS)}; default: all")
    parser.add_argument("--cost", action="store_true", help="take the processor time of the driver instead")
    parser.add_argument("--rounds", type=int, default=50, help="replugs of each device")
    parser.add_argument("--load", type=int, default=2, help="processes that compute meanwhile")
    parser.add_argument("--seconds", type=float, default=6.0, help="time for each measurement of --cost")


SUBJECT = TrialSubject(
    play=play,
    options=options,
    kinds=lambda chosen: names_of(chosen.devices, TRIALS),
    is_good=in_time,
    results="devices",
    seeds=1,
    seed_makes="the moments of replugs",
)
