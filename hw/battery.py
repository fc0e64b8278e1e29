"""What every battery offers that measures itself, whatever hardware is behind it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass


@dataclass(frozen=True)
class BatteryReading:
    """The state of a battery at one moment.

    Attributes:
        stamp_s: when, in the time of the device's clock.
        voltage_v: at the terminals.
        current_a: drawn from it.
        charge_ah: what is left.
        capacity_ah: what it holds when full.
    """

    stamp_s: float
    voltage_v: float
    current_a: float
    charge_ah: float
    capacity_ah: float


class Battery(ABC):
    """A battery that measures itself."""

    @abstractmethod
    def read(self) -> BatteryReading:
        """Return its state."""
