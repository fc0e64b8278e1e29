"""The body that an emulated base moves, with motors, wheels and encoders."""

from abc import ABC, abstractmethod
from collections import deque
from threading import Lock

import numpy as np

from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState

# An emulated base moves its body again much earlier.
VALID_S = 1.0
# Readings of the encoders in memory: an emulator that is late looks back at most this far.
KEPT = 100


class WheeledBody(ABC):
    """A body on two driven wheels."""

    @abstractmethod
    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, at_s: float
    ) -> tuple[float, float]:
        """Turn the wheels at these speeds from now on, and tell what the encoders have counted.

        Args:
            linear_m_per_s: speed forward that the motors were told.
            angular_rad_per_s: turn rate that the motors were told, positive to the left.
            passed_s: time since the last call.
            at_s: the true time at which the encoders are read, now or before: they tell what they had counted
                then. An emulator that a busy machine let wait reads them later than its controller does.

        Returns:
            The way forward, m, and the turn, rad, since the last call, by the encoders.
        """


class ObedientBody(WheeledBody):
    """A body without mass in a world without walls."""

    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, at_s: float
    ) -> tuple[float, float]:
        """Move exactly as told."""
        return linear_m_per_s * passed_s, angular_rad_per_s * passed_s


class SimulatedBody(WheeledBody):
    """A body in a simulated arena: it has mass, its wheels slip, and walls stop it. Threads may share it.

    Args:
        drive: the simulated drive, whose clock tells the true time; nobody else may command it.
        shape: the same geometry and limits as the drive's.
    """

    def __init__(self, drive: SimulatedDrive, shape: DifferentialDrive) -> None:
        self._drive, self._shape, self._lock = drive, shape, Lock()
        # When, by the drive's clock, the wheels had turned how far: way, m, and turn, rad.
        self._read: deque[tuple[float, float, float]] = deque([self._counted(drive.read().stamp_s)], KEPT)
        self._told = self._read[0][1:]

    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, at_s: float
    ) -> tuple[float, float]:
        """Move as the motors, the wheels and the walls let it."""
        with self._lock:
            state = self._drive.read()
            if state.stamp_s > self._read[-1][0]:
                self._read.append(self._counted(state.stamp_s))
            before, self._told = self._told, self._turned(at_s, state)
            self._drive.command(linear_m_per_s, angular_rad_per_s, VALID_S)
        return self._told[0] - before[0], self._told[1] - before[1]

    def _counted(self, stamp_s: float) -> tuple[float, float, float]:
        """Return how far the encoders say that the wheels have turned by now."""
        left_m, right_m = (count * self._shape.tick_m for count in self._drive.ticks)
        return stamp_s, (left_m + right_m) / 2, (right_m - left_m) / self._shape.axle_m

    def _turned(self, at_s: float, state: DriveState) -> tuple[float, float]:
        """Return how far the wheels had turned at a time."""
        read_s, way_m, turn_rad = self._read[-1]
        if at_s >= read_s:
            # The drive moves in steps, real wheels do not: they have turned a little farther.
            since_s = at_s - read_s
            return way_m + state.linear_m_per_s * since_s, turn_rad + state.angular_rad_per_s * since_s
        times_s, ways_m, turns_rad = zip(*self._read, strict=True)
        return float(np.interp(at_s, times_s, ways_m)), float(np.interp(at_s, times_s, turns_rad))

    def ground_truth(self) -> DriveState:
        """Return the robot's true state, arena frame."""
        with self._lock:
            return self._drive.ground_truth()

    def world_state(self) -> WorldState:
        """Return the state from which a drive in a new process can continue."""
        with self._lock:
            return self._drive.world_state()
