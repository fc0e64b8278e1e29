"""What every bumper offers, whatever hardware is behind it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

PARTS = ("front_left", "back_left", "back_right", "front_right")


@dataclass(frozen=True)
class Contact:
    """What the bumper touches at one moment.

    Attributes:
        stamp_s: when, in the time of the device's clock.
        pressed: those of `PARTS` that touch something.
    """

    stamp_s: float
    pressed: tuple[str, ...]


class Bumper(ABC):
    """A ring of four switches around the robot, each a quarter."""

    @abstractmethod
    def read(self) -> Contact:
        """Return what it touches."""
