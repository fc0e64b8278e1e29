"""The interface of drives."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from robbie_robots.hw.pose import Pose

MAX_VALID_FOR_S = 1.0
"""No command moves a robot for longer, whatever it says."""


class DriveCommandError(ValueError):
    """An invalid command: a value is NaN or infinite, or the validity is not positive."""


@dataclass(frozen=True)
class DriveState:
    """The motion state of a robot at one time.

    Attributes:
        stamp_s: time of the state, on the drive's clock.
        pose: the robot's pose, in the frame that the method names.
        linear_m_per_s: forward speed.
        angular_rad_per_s: turn rate, positive to the left.
    """

    stamp_s: float
    pose: Pose
    linear_m_per_s: float
    angular_rad_per_s: float


class Drive(ABC):
    """A drive that follows velocity commands and measures wheel odometry.

    Commands expire, so that a robot whose control program has died stops. An emergency stop latches: the
    robot ignores all commands until the stop is released.
    """

    @abstractmethod
    def command(self, linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
        """Drive at these speeds until the next command, but no longer than `valid_for_s`.

        No command lasts longer than `MAX_VALID_FOR_S`.

        Speeds are clamped to the drive's limits. During an emergency stop the command has no effect.

        Raises:
            DriveCommandError: a value is NaN or infinite, or `valid_for_s` is not positive.
        """

    @abstractmethod
    def read(self) -> DriveState:
        """Return the robot's state by wheel odometry (odometry frame)."""

    @abstractmethod
    def stop(self) -> None:
        """Brake to a halt."""

    @abstractmethod
    def stop_for_emergency(self) -> None:
        """Brake as hard as possible; do not move again before `release`."""

    @abstractmethod
    def release(self) -> None:
        """Release the emergency stop; the drive stands still until the next command."""

    @property
    @abstractmethod
    def is_emergency_stopped(self) -> bool:
        """Return whether the emergency stop is engaged."""


def capped_validity_s(linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> float:
    """Return how long a command is followed: for `valid_for_s`, but not for longer than `MAX_VALID_FOR_S`.

    Raises:
        DriveCommandError: the command is invalid.
    """
    values = {
        "linear_m_per_s": linear_m_per_s,
        "angular_rad_per_s": angular_rad_per_s,
        "valid_for_s": valid_for_s,
    }
    for name, value in values.items():
        if not math.isfinite(value):
            raise DriveCommandError(f"{name} of a drive command must be a finite number, not {value}")
    if valid_for_s <= 0:
        raise DriveCommandError(f"valid_for_s of a drive command must be greater than 0, not {valid_for_s:g}")
    return min(valid_for_s, MAX_VALID_FOR_S)
