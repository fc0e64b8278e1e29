"""Base of the drivers of bases on a port: expiring commands, the emergency stop, and odometry."""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Unpack

from robbie_robots.hw.battery import BatteryReading
from robbie_robots.hw.connection.clock import RegularClock
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.connection.stop_guard import PING_PERIOD_S, StopGuards
from robbie_robots.hw.drive import Drive, DriveState, capped_validity_s
from robbie_robots.hw.odometry import Odometer, OdometryNoise

# Start bit, eight data bits, stop bit.
BITS_PER_BYTE = 10


@dataclass(frozen=True)
class BaseLimits:
    """The greatest speeds."""

    linear_m_per_s: float
    angular_rad_per_s: float


@dataclass(frozen=True)
class BaseReading:
    """The report of a base at one time.

    Attributes:
        state: its motion by wheel odometry.
        covariance: (3, 3), of the pose's x, y and heading.
        pressed: the bumper's parts that touch something, of `robbie_robots.hw.bumper.PARTS`.
        battery: None if it does not tell.
        charging: whether a charger charges the battery; None if it does not tell.
        problems: why it may not move, in plain words, such as "cliff on the left".
        sonar_m: distances by the sonars' numbers; +inf: nothing seen.
    """

    state: DriveState
    covariance: NDArray[np.float64]
    pressed: tuple[str, ...]
    battery: BatteryReading | None
    charging: bool | None
    problems: tuple[str, ...]
    sonar_m: dict[int, float]


class ConnectedBase(PluggableDevice[BaseReading], Drive):
    """A base on a port.

    Whatever moves it expires. Three things watch over that: `poll` stops the robot as soon as a command
    has expired; two guards, which are processes besides, stop it when the driver's process has died or hangs;
    and after each connection the robot stands until the next command. When a guard is lost, the robot
    stands until a new guard answers and the next command comes. A port without a descriptor (`rfc2217://`)
    has no guard.

    A base reports at a regular period but does not tell when. The stamps of its reports are estimated as by
    `RegularClock`, without the time that a report takes on the line.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        bit_rate: bit/s at the start, on a serial line.
        limits: faster commands are clamped to these.
        noise: how much the wheels slip.
        period_s: from report to report.
        options: see `DeviceOptions`.
    """

    SILENCE_S = 0.5

    def __init__(
        self,
        url: str,
        bit_rate: int,
        limits: BaseLimits,
        noise: OdometryNoise | None = None,
        *,
        period_s: float,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self.limits = limits
        self.odometer = Odometer(noise)
        self.expired_commands = 0
        """How many commands have ended because no newer one came in time."""
        self.ignored_commands = 0
        """How many commands came while it was disconnected, its emergency stop engaged, or its guard lost."""
        self.guards_replaced = 0
        """How many guards were lost, and replaced."""
        self._stamps = RegularClock(period_s)
        self._gaps = 0
        self._valid_until_s: float | None = None
        self._is_emergency_stopped = False
        self._guard: StopGuards | None = None
        self._guard_problem = ""
        self._speeds = (0.0, 0.0)

    def command(self, linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
        """Drive at these speeds until the next command, but no longer than `valid_for_s`."""
        valid_for_s = capped_validity_s(linear_m_per_s, angular_rad_per_s, valid_for_s)
        until_s = self._monotonic() + valid_for_s
        if not self.is_connected or self._is_emergency_stopped or not self._allow(valid_for_s):
            self.ignored_commands += 1
            return
        # Both speeds shrink alike, so that the robot drives the same curve.
        excess = max(
            1.0,
            abs(linear_m_per_s) / self.limits.linear_m_per_s,
            abs(angular_rad_per_s) / self.limits.angular_rad_per_s,
        )
        motion = self._motion(linear_m_per_s / excess, angular_rad_per_s / excess)
        self._valid_until_s = until_s
        # This process may have been stopped meanwhile, or be stopped in the middle of the write.
        if not self._stop_expired():
            self.send(motion)
            self._stop_expired()

    def read(self) -> DriveState:
        """Return the robot's state by wheel odometry; without a connection it counts as standing."""
        return DriveState(self._clock(), self.odometer.pose, *self._speeds)

    def stop(self) -> None:
        """Brake to a halt."""
        self._valid_until_s = None
        self.send(self._halt())
        self._allow(0.0)

    def stop_for_emergency(self) -> None:
        """Brake as hard as possible; do not move again before `release`."""
        self._is_emergency_stopped = True
        self.stop()

    def release(self) -> None:
        """Release the emergency stop; the robot stands until the next command."""
        self._is_emergency_stopped = False

    @property
    def is_emergency_stopped(self) -> bool:
        """Return whether the emergency stop is engaged."""
        return self._is_emergency_stopped

    @property
    def is_guarded(self) -> bool:
        """Return whether a guard would stop the robot if this process died."""
        return self._guard is not None and self._guard.is_answering

    def poll(self, wait_s: float = 0.0) -> list[BaseReading]:
        """Return what the base has reported since the last call; stop it when a command has expired."""
        if self._valid_until_s is not None:
            wait_s = max(0.0, min(wait_s, self._valid_until_s - self._monotonic()))
        if self._guard is not None:
            wait_s = min(wait_s, PING_PERIOD_S)
        readings = super().poll(wait_s)
        self._stop_expired()
        return self._watch_guard(readings)

    def _stop_expired(self) -> bool:
        """Stop the robot if its command has expired. Return whether it has."""
        has_expired = self._valid_until_s is not None and self._monotonic() >= self._valid_until_s
        if has_expired:
            self.expired_commands += 1
            self.stop()
        return has_expired

    def _watch_guard(self, readings: list[BaseReading]) -> list[BaseReading]:
        """Stop the robot when its guard is lost, and tell so in a reading at least."""
        if self._guard is not None and (lost := self._guard.watch()):
            self.guards_replaced += 1
            self._guard_problem = lost
            self.stop()
        if not (self._guard_problem and readings):
            return readings
        told = [replace(one, problems=(*one.problems, self._guard_problem)) for one in readings]
        if self.is_guarded:
            self._guard_problem = ""
        return told

    def _allow(self, valid_for_s: float) -> bool:
        """Tell the guard for how long the robot may move. Return whether it may."""
        return self._guard is None or self._guard.allow(valid_for_s)

    @abstractmethod
    def _motion(self, linear_m_per_s: float, angular_rad_per_s: float) -> bytes:
        """Return the bytes of a command to drive."""

    @abstractmethod
    def _halt(self) -> bytes:
        """Return the bytes that stop the wheels, whatever the base was told before."""

    @abstractmethod
    def _greet(self, port: Port) -> None:
        """Talk to the base until it sends; see `PluggableDevice._start`."""

    def _start(self, port: Port) -> None:
        self._greet(port)
        port.write(self._halt())
        if port.descriptor is not None:
            self._guard = StopGuards(port.descriptor, self._halt())

    def _reset(self) -> None:
        self._valid_until_s = None
        self._speeds = (0.0, 0.0)
        self._stamps.forget()
        self._guard_problem = ""
        if self._guard is not None:
            self._guard.close()
            self._guard = None

    def _stop(self) -> None:
        self.stop()

    def _report_stamp_s(self, arrived_s: float, report_bytes: int) -> float:
        """Return when the newest report was made. Call it once for each, with the counters up to date.

        Args:
            arrived_s: when its last byte was here.
            report_bytes: its length.
        """
        gaps = self.counters.damaged + self.counters.skipped_bytes
        has_gap, self._gaps = gaps != self._gaps, gaps
        # A base that is simulated elsewhere is at a TCP port, on which bytes take no time.
        sent_s = 0.0 if self.url.startswith("socket://") else report_bytes * BITS_PER_BYTE / self.bit_rate
        return self._stamps.stamp_s(arrived_s - sent_s, has_gap=has_gap)

    def _moved(
        self, stamp_s: float, distance_m: float, turn_rad: float, speeds: tuple[float, float]
    ) -> DriveState:
        """Add a motion to the odometry; return the state after it."""
        if distance_m or turn_rad:
            self.odometer.add(distance_m, turn_rad)
        self._speeds = speeds
        return DriveState(stamp_s, self.odometer.pose, *speeds)


def difference(newer: int, older: int, modulus: int) -> int:
    """Return how far a counter that wraps has gone, by the shorter way."""
    return (newer - older + modulus // 2) % modulus - modulus // 2


def nothing_beyond(distance_m: float, most_m: float) -> float:
    """Return a distance, or +inf if it is the sensor's greatest or more."""
    return math.inf if distance_m >= most_m else distance_m
