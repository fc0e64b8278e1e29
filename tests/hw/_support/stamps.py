"""Stamps of the drivers of lasers and bases, on emulated devices in simulated time.

The line has 2 ms of jitter, 3 % of its frames are late by 30 ms more, and each byte takes its time. A stamp
should name the time at which the first beam of the sweep was measured (Hokuyo: the one moment at which the
emulated laser measures), or at which the base read its encoders. In simulated time a busy machine adds
nothing: the error is the driver's. The device's clock runs 0.01 % too fast.
"""

import math
from collections.abc import Callable
from contextlib import closing
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.connected_base import BaseReading
from robbie_robots.hw.connection.device import PluggableDevice
from robbie_robots.hw.emulation.body import ObedientBody
from robbie_robots.hw.emulation.cola import LMS_111, TIM_561, EmulatedSickScanner, ScannerModel
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.lms2xx import EmulatedLms2xx
from robbie_robots.hw.emulation.p2os import EmulatedPioneer, PioneerState
from robbie_robots.hw.emulation.rplidar import A1, A3, S2, EmulatedRpLidar, RpLidarModel
from robbie_robots.hw.emulation.scip import URG_04LX, UTM_30LX, EmulatedHokuyo, LaserModel
from robbie_robots.hw.emulation.stepped_line import SteppedLine, SteppedTime
from robbie_robots.hw.hokuyo.laser import HokuyoLaser
from robbie_robots.hw.irobot.create import CreateBase
from robbie_robots.hw.laser import DeviceSweep
from robbie_robots.hw.pioneer.base import PioneerBase
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.hw.sick.cola import Dialect
from robbie_robots.hw.sick.cola_laser import SickColaLaser
from robbie_robots.hw.sick.lms2xx import SickLms2xx

Array = NDArray[np.float64]

LATE = Faults(jitter_s=0.002, late_share=0.03, late_s=0.03)
DRIFT = 1e-4
SETTLED_S = 5.0
STAMP_S = 0.001
# Sweeps are told apart by their ranges.
FIRST_M, STEP_M, DIFFERENT = 1.0, 0.01, 300
# The number of the packet that numbers a Create's reports.
VOLTAGE = 22


class Measured:
    """The ranges of a wall that moves with each sweep, and when each sweep began, by the true time.

    For a base: the numbers of its reports, and when each was made.
    """

    def __init__(self, clock: SteppedTime) -> None:
        self.began_s: dict[int, float] = {}
        self._clock = clock

    def range_m(self, number: int, began_s: float | None = None) -> float:
        """Return the range of a sweep that begins now, or at a given time."""
        self.began_s.setdefault(number % DIFFERENT, 0.0)
        self.began_s[number % DIFFERENT] = self._clock.now_s if began_s is None else began_s
        return FIRST_M + STEP_M * (number % DIFFERENT)

    def next_range_m(self, began_s: float | None = None) -> float:
        """Return the range of a sweep that nobody has numbered."""
        self._numbered = getattr(self, "_numbered", -1) + 1
        return self.range_m(self._numbered, began_s)

    def next_number(self) -> int:
        """Return the number of a report that is made now."""
        self.next_range_m()
        return self._numbered % DIFFERENT


def _sweep(sweep: DeviceSweep) -> tuple[float, int]:
    seen_m = float(np.median(sweep.ranges_m[np.isfinite(sweep.ranges_m)]))
    return sweep.stamp_s, round((seen_m - FIRST_M) / STEP_M)


class Driver(NamedTuple):
    """A device and its driver.

    Attributes:
        emulated: makes the device.
        driver: makes the driver.
        seen: returns stamp, s, and number of what the driver measured.
    """

    emulated: Callable[[Measured, EmulatedClock], EmulatedDevice]
    driver: Callable[[SteppedTime], PluggableDevice[Any]]
    seen: Callable[[Any], tuple[float, int]] = _sweep


def _hokuyo(model: LaserModel) -> Driver:
    beams = len(model.angles_rad())
    return Driver(
        lambda measured, clock: EmulatedHokuyo(
            model, lambda measured_s: np.full(beams, measured.next_range_m(measured_s)), clock
        ),
        lambda clock: HokuyoLaser("simulated", clock=clock, latency_s=model.latency_s),
    )


def _cola(model: ScannerModel, dialect: Dialect) -> Driver:
    return Driver(
        lambda measured, clock: EmulatedSickScanner(
            lambda number: np.full(model.beams, measured.range_m(number)), model, dialect is Dialect.A, clock
        ),
        lambda clock: SickColaLaser("simulated", clock=clock, dialect=dialect),
    )


def _lms2xx(bit_rate: int, field_deg: int, resolution_deg: float) -> Driver:
    def emulated(measured: Measured, clock: EmulatedClock) -> EmulatedLms2xx:
        def measure(number: int, angles: Array) -> Array:
            return np.full(len(angles), measured.range_m(number, clock.true_s(device.scans_began_s)))

        device = EmulatedLms2xx(measure, clock)
        return device

    return Driver(
        emulated,
        lambda clock: SickLms2xx(
            "simulated", clock=clock, bit_rate=bit_rate, field_deg=field_deg, resolution_deg=resolution_deg
        ),
    )


def _rplidar(model: RpLidarModel, mode: str) -> Driver:
    def emulated(measured: Measured, clock: EmulatedClock) -> EmulatedRpLidar:
        def measure(turns: NDArray[np.int64], angles: Array) -> Array:
            # A turn begins with its first sample.
            whole = {
                turn: measured.range_m(turn, clock.true_s(device.first_sample_s(turn)))
                for turn in np.unique(turns).tolist()
            }
            return np.array([whole[turn] for turn in turns.tolist()])

        device = EmulatedRpLidar(measure, model, clock)
        return device

    return Driver(
        emulated,
        lambda clock: RpLidar("simulated", clock=clock, bit_rate=model.bit_rate, mode=mode, monotonic=clock),
    )


class NumberingBody(ObedientBody):
    """A body that has the base number its reports: it is moved before each of them.

    Args:
        number: sets the number.
    """

    def __init__(self, number: Callable[[], None]) -> None:
        self._number = number

    def move(self, *told: float) -> tuple[float, float]:
        """Number the next report."""
        self._number()
        return super().move(*told)


def _create() -> Driver:
    def emulated(measured: Measured, clock: EmulatedClock) -> EmulatedCreate:
        def number() -> None:
            device.sensors[VOLTAGE] = measured.next_number()

        device = EmulatedCreate(clock, NumberingBody(number))
        return device

    def seen(reading: BaseReading) -> tuple[float, int]:
        assert reading.battery is not None
        return reading.state.stamp_s, round(1000 * reading.battery.voltage_v)

    return Driver(emulated, lambda clock: CreateBase("simulated", clock=clock, monotonic=clock), seen)


def _pioneer(bit_rate: int) -> Driver:
    def emulated(measured: Measured, clock: EmulatedClock) -> EmulatedPioneer:
        def number() -> None:
            device.base.sonars_mm[0] = measured.next_number()

        device = EmulatedPioneer(clock, PioneerState(bit_rate=bit_rate), NumberingBody(number))
        return device

    return Driver(
        emulated,
        lambda clock: PioneerBase("simulated", bit_rate, clock=clock, monotonic=clock),
        lambda reading: (reading.state.stamp_s, round(1000 * reading.sonar_m[0])),
    )


SUBJECTS = {
    "Create 2": _create(),
    "Pioneer, 9600": _pioneer(9_600),
    "Pioneer, 57600": _pioneer(57_600),
    "URG-04LX": _hokuyo(URG_04LX),
    "UTM-30LX": _hokuyo(UTM_30LX),
    "TiM561, CoLa B": _cola(TIM_561, Dialect.B),
    "TiM561, CoLa A": _cola(TIM_561, Dialect.A),
    "LMS111, CoLa B": _cola(LMS_111, Dialect.B),
    "LMS2xx, 500000, 180 by 1": _lms2xx(500_000, 180, 1.0),
    "LMS2xx, 500000, 180 by 0.5": _lms2xx(500_000, 180, 0.5),
    "LMS2xx, 500000, 100 by 0.25": _lms2xx(500_000, 100, 0.25),
    "LMS2xx, 38400, 180 by 0.5": _lms2xx(38_400, 180, 0.5),
    "LMS2xx, 38400, 180 by 1": _lms2xx(38_400, 180, 1.0),
    "LMS2xx, 9600, 180 by 1": _lms2xx(9_600, 180, 1.0),
    "RPLidar A1, standard": _rplidar(A1, "standard"),
    "RPLidar A1, express": _rplidar(A1, "express"),
    "RPLidar A3, express": _rplidar(A3, "express"),
    "RPLidar A3, ultra": _rplidar(A3, "ultra"),
    "RPLidar A3, hq": _rplidar(A3, "hq"),
    "RPLidar S2, dense": _rplidar(S2, "dense"),
}


def stamp_errors(subject: Driver, seconds: float, seed: int = 0, faults: Faults = LATE) -> Array:
    """Return how late the stamps of a driver are, s, without those of the first seconds: (N,)."""
    clock = SteppedTime()
    measured = Measured(clock)
    device = subject.emulated(measured, EmulatedClock(start_s=7.0, drift=DRIFT, monotonic=clock))
    line = SteppedLine(device, clock, faults, seed)
    errors = []
    with closing(subject.driver(clock)) as driver:
        driver._open_port = line.opened
        # Silence of a laser is measured in real time, of which a busy machine may take any amount.
        driver.silence_s = math.inf
        while not driver.poll(0.5):
            pass
        settled_s = clock.now_s + SETTLED_S
        while clock.now_s < settled_s + seconds:
            for value in driver.poll(0.5):
                if clock.now_s >= settled_s:
                    stamp_s, number = subject.seen(value)
                    errors.append(stamp_s - measured.began_s[number])
    return np.array(errors)
