"""The interface of joints that are moved to positions: a gripper, a pan-tilt unit, an arm."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


class JointCommandError(ValueError):
    """An invalid command: a joint that does not exist, a position that is no number, or no validity."""


@dataclass(frozen=True)
class Joint:
    """One joint. The angles of a joint that slides are lengths, in m.

    Attributes:
        name: its name.
        least_rad: least position; commands beyond go only so far.
        most_rad: greatest position.
        speed_rad_per_s: how fast it moves.
    """

    name: str
    least_rad: float = -math.pi
    most_rad: float = math.pi
    speed_rad_per_s: float = 1.0


@dataclass(frozen=True)
class JointReading:
    """The state of all joints at one time, in the order of their list.

    Attributes:
        stamp_s: time of the reading.
        positions_rad: positions.
        speeds_rad_per_s: speeds.
        problems: what the joints report, in plain words.
    """

    stamp_s: float
    positions_rad: tuple[float, ...]
    speeds_rad_per_s: tuple[float, ...]
    problems: tuple[str, ...] = ()


class Joints(ABC):
    """Joints that follow commands to positions. A command that expires lets all joints go."""

    @property
    @abstractmethod
    def joints(self) -> Sequence[Joint]:
        """Return the joints."""

    @abstractmethod
    def command(self, positions_rad: Mapping[str, float], valid_for_s: float) -> None:
        """Move joints to positions, by name; the others keep their goals.

        When `valid_for_s`, or `MAX_VALID_FOR_S`, passes without another command, all joints are let go
        (torque off). With +inf they keep their goals.

        Raises:
            JointCommandError: see `checked`.
        """

    @abstractmethod
    def release(self) -> None:
        """Let all joints go."""


MAX_VALID_FOR_S = 1.0


def capped_validity_s(valid_for_s: float) -> float:
    """Return how long a command is followed: at most `MAX_VALID_FOR_S`; +inf: until the next."""
    return valid_for_s if math.isinf(valid_for_s) else min(valid_for_s, MAX_VALID_FOR_S)


def checked(
    joints: Sequence[Joint], positions_rad: Mapping[str, float], valid_for_s: float
) -> dict[int, float]:
    """Return the commanded positions within the joints' limits, by the place in the list.

    Raises:
        JointCommandError: a joint does not exist, a position is NaN or infinite, or `valid_for_s` is not
            positive.
    """
    if not valid_for_s > 0:
        raise JointCommandError(f"valid_for_s of a joint command must be greater than 0, not {valid_for_s:g}")
    places = {joint.name: place for place, joint in enumerate(joints)}
    goals = {}
    for name, position in positions_rad.items():
        if name not in places:
            raise JointCommandError(f"there is no joint {name!r}; the joints are {', '.join(places)}")
        if not math.isfinite(position):
            raise JointCommandError(f"the position of joint {name!r} must be a finite number, not {position}")
        joint = joints[places[name]]
        goals[places[name]] = max(joint.least_rad, min(joint.most_rad, position))
    return goals
