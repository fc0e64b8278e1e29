"""The interface of batteries with sensors."""

from abc import ABC, abstractmethod
from dataclasses import dataclass


@dataclass(frozen=True)
class BatteryReading:
    """The state of a battery at one moment.

    Attributes:
        stamp_s: time of the reading, on the device's clock.
        voltage_v: voltage at the terminals.
        current_a: discharge current.
        charge_ah: remaining charge.
        capacity_ah: charge when full.
    """

    stamp_s: float
    voltage_v: float
    current_a: float
    charge_ah: float
    capacity_ah: float


class Battery(ABC):
    """A battery that measures its own state."""

    @abstractmethod
    def read(self) -> BatteryReading:
        """Return the battery's state."""
