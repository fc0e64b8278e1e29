"""The interface of bumpers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

PARTS = ("front_left", "back_left", "back_right", "front_right")


@dataclass(frozen=True)
class Contact:
    """The bumper's contacts at one time.

    Attributes:
        stamp_s: time of the reading, on the device's clock.
        pressed: the elements of `PARTS` that touch something.
    """

    stamp_s: float
    pressed: tuple[str, ...]


class Bumper(ABC):
    """A ring of four switches around the robot, one for each quarter."""

    @abstractmethod
    def read(self) -> Contact:
        """Return the current contacts."""
