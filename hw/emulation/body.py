"""The body that an emulated base moves:, with motors, wheels and encoders."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from threading import Lock

from hw.drive import DriveState
from hw.simulation.differential_drive import DifferentialDrive
from hw.simulation.drive import SimulatedDrive, WorldState

# An emulated base moves its body again much earlier.
VALID_S = 1.0


class Body(ABC):
    """A body on two driven wheels."""

    @abstractmethod
    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, late_s: float = 0.0
    ) -> tuple[float, float]:
        """Turn the wheels at these speeds from now on, and tell what the encoders have counted.

        Args:
            linear_m_per_s: speed forward that the motors were told.
            angular_rad_per_s: turn rate that the motors were told, positive to the left.
            passed_s: time since the last call.
            late_s: how long ago the encoders should have been read: they tell what they had counted then.

        Returns:
            The way forward, m, and the turn, rad, since the last call, by the encoders.
        """


class ObedientBody(Body):
    """A body without mass in a world without walls."""

    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, late_s: float = 0.0
    ) -> tuple[float, float]:
        """Move exactly as told."""
        return linear_m_per_s * passed_s, angular_rad_per_s * passed_s


class SimulatedBody(Body):
    """A body in a simulated arena: it has mass, its wheels slip, and walls stop it. Threads may share it.

    Args:
        drive: the simulated drive; nobody else may command it.
        shape: the same geometry and limits as the drive's.
        clock: the drive's clock, s.
    """

    def __init__(self, drive: SimulatedDrive, shape: DifferentialDrive, clock: Callable[[], float]) -> None:
        self._drive, self._shape, self._clock, self._lock = drive, shape, clock, Lock()
        self._counted = drive.ticks
        self._ahead = (0.0, 0.0)

    def move(
        self, linear_m_per_s: float, angular_rad_per_s: float, passed_s: float, late_s: float = 0.0
    ) -> tuple[float, float]:
        """Move as the motors, the wheels and the walls let it."""
        with self._lock:
            state = self._drive.read()
            ticks = self._drive.ticks
            left_m, right_m = (
                (now - before) * self._shape.tick_m for now, before in zip(ticks, self._counted, strict=True)
            )
            self._counted = ticks
            # The drive moves in steps, real wheels do not: up to now they have turned a little farther. An
            # emulator that a busy machine let wait reads them too late: then they had turned less.
            since_s = max(0.0, self._clock() - state.stamp_s) - late_s
            before, self._ahead = (
                self._ahead,
                (state.linear_m_per_s * since_s, state.angular_rad_per_s * since_s),
            )
            more_m, more_rad = self._ahead[0] - before[0], self._ahead[1] - before[1]
            self._drive.command(linear_m_per_s, angular_rad_per_s, VALID_S)
        return (left_m + right_m) / 2 + more_m, (right_m - left_m) / self._shape.axle_m + more_rad

    def ground_truth(self) -> DriveState:
        """Return the robot's true state, arena frame."""
        with self._lock:
            return self._drive.ground_truth()

    def world_state(self) -> WorldState:
        """Return the state from which a drive in a new process can continue."""
        with self._lock:
            return self._drive.world_state()
