"""A simulated lithium-ion battery that a robot drains."""

import math
from dataclasses import dataclass, replace

import numpy as np

from robbie_robots.hw.battery import Battery, BatteryReading
from robbie_robots.hw.drive import DriveState

# Open-circuit voltage of a lithium-ion cell, V, over the remaining charge, as a ratio.
CHARGE = (0.0, 0.05, 0.1, 0.2, 0.5, 0.8, 1.0)
CELL_V = (3.0, 3.35, 3.5, 3.6, 3.75, 3.98, 4.2)


@dataclass(frozen=True)
class BatteryModel:
    """A battery and a robot's power consumption. With the defaults, the stock robot runs for about two hours.

    Attributes:
        capacity_ah: charge when full.
        cells: number of cells in series.
        resistance_ohm: internal resistance.
        idle_w: power of a robot that stands still.
        driving_w_per_m_per_s: additional power per m/s.
        turning_w_per_rad_per_s: additional power per rad/s.
    """

    capacity_ah: float = 5.0
    cells: int = 4
    resistance_ohm: float = 0.08
    idle_w: float = 20.0
    driving_w_per_m_per_s: float = 30.0
    turning_w_per_rad_per_s: float = 6.0

    def power_w(self, linear_m_per_s: float, angular_rad_per_s: float) -> float:
        """Return the robot's power at these speeds."""
        driving = self.driving_w_per_m_per_s * abs(linear_m_per_s)
        return self.idle_w + driving + self.turning_w_per_rad_per_s * abs(angular_rad_per_s)

    def open_circuit_v(self, charge_ah: float) -> float:
        """Return the voltage without a load."""
        return self.cells * float(np.interp(charge_ah / self.capacity_ah, CHARGE, CELL_V))

    def current_a(self, power_w: float, charge_ah: float) -> float:
        """Return the current for a power at the terminals, or the maximum current.

        Solves power = (open-circuit voltage - resistance * current) * current.
        """
        open_v = self.open_circuit_v(charge_ah)
        root = open_v**2 - 4 * self.resistance_ohm * power_w
        return (open_v - math.sqrt(max(root, 0.0))) / (2 * self.resistance_ohm)


class SimulatedBattery(Battery):
    """A battery that drains with time, faster when the robot moves faster.

    Args:
        model: the battery and the robot's consumption.
        charge_ah: initial charge; by default, the battery is full.
    """

    def __init__(self, model: BatteryModel | None = None, charge_ah: float | None = None) -> None:
        self._model = model or BatteryModel()
        charge = self._model.capacity_ah if charge_ah is None else charge_ah
        self._reading = BatteryReading(
            -math.inf, self._model.open_circuit_v(charge), 0.0, charge, self._model.capacity_ah
        )

    def drain(self, truth: DriveState) -> None:
        """Drain the charge that the robot consumed since the last call. The first call drains nothing."""
        model, before = self._model, self._reading
        power_w = model.power_w(truth.linear_m_per_s, truth.angular_rad_per_s)
        current_a = model.current_a(power_w, before.charge_ah) if before.charge_ah > 0 else 0.0
        passed_s = truth.stamp_s - before.stamp_s
        taken_ah = current_a * passed_s / 3600 if 0 < passed_s < math.inf else 0.0
        charge_ah = max(0.0, before.charge_ah - taken_ah)
        voltage_v = model.open_circuit_v(charge_ah) - model.resistance_ohm * current_a
        self._reading = BatteryReading(truth.stamp_s, voltage_v, current_a, charge_ah, model.capacity_ah)

    def set_charge(self, charge_ah: float) -> None:
        """Set the charge."""
        open_v = self._model.open_circuit_v(charge_ah)
        self._reading = replace(self._reading, charge_ah=charge_ah, voltage_v=open_v, current_a=0.0)

    def read(self) -> BatteryReading:
        """Return the state after the last call of `drain` or `set_charge`."""
        return self._reading
