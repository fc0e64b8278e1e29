"""What every drive offers, whatever hardware is behind it."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from hw.pose import Pose


class DriveCommandError(ValueError):
    """A command that no drive can follow: not a number, infinite, or valid for no time."""


@dataclass(frozen=True)
class DriveState:
    """How a robot moves at one moment.

    Attributes:
        stamp_s: when, in the time of the drive's clock.
        pose: where, in the frame the method names.
        linear_m_per_s: speed ahead.
        angular_rad_per_s: speed of the turn, positive to the left.
    """

    stamp_s: float
    pose: Pose
    linear_m_per_s: float
    angular_rad_per_s: float


class Drive(ABC):
    """A drive that follows velocity commands and counts its wheels' turns.

    A command expires: a robot whose control program has died must not drive on. An emergency stop latches:
    whatever commands still come, the robot stands until it is released.
    """

    @abstractmethod
    def command(self, linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
        """Drive at these speeds until the next command, but no longer than `valid_for_s`.

        Speeds beyond the drive's limits are cut down to the limits. In an emergency stop nothing is driven.

        Raises:
            DriveCommandError: a value is NaN or infinite, or `valid_for_s` is not positive.
        """

    @abstractmethod
    def read(self) -> DriveState:
        """Return where the wheels say the robot is (odometry frame) and how it moves."""

    @abstractmethod
    def stop(self) -> None:
        """Brake to a halt."""

    @abstractmethod
    def stop_for_emergency(self) -> None:
        """Brake as hard as possible, and do not move again before `release`."""

    @abstractmethod
    def release(self) -> None:
        """End the emergency stop; the drive stands until the next command."""

    @property
    @abstractmethod
    def is_emergency_stopped(self) -> bool:
        """Say whether the drive is in an emergency stop."""


def check_command(linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
    """Raise DriveCommandError unless a drive can follow the command."""
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
