"""The robot's battery."""

import math

from robbie_mp import Header, setting
from robbie_mp.messages import BatteryState
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.simulation.battery import BatteryModel, SimulatedBattery
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice


class SimulatedBatteryModule(SimulatedDevice):
    """A simulated battery drained by time and motion; publishes `BatteryState` on topic `battery`.

    Its charge survives a restart.
    """

    capacity_ah: float = setting(5.0, "capacity when full, Ah", minimum=0.001)
    first_charge: float = setting(1.0, "charge at the first start, as a ratio", minimum=0.0, maximum=1.0)
    virtual_charge: float | None = setting(
        None,
        "sets the charge, as a ratio, from now on; null: leaves it to the simulation",
        minimum=0.0,
        maximum=1.0,
        changeable=True,
    )
    period_s: float = setting(1.0, "time between messages", minimum=0.05)

    def setup(self) -> None:
        """Create the battery."""
        first = self.first_charge if self.virtual_charge is None else self.virtual_charge
        charge_ah = first * self.capacity_ah if self.restored is None else self.restored["charge_ah"]
        self.battery = SimulatedBattery(BatteryModel(self.capacity_ah), charge_ah)
        self.world = SharedWorld(self, self.on_truth)

    def setting_changed(self, _name: str) -> None:
        """Set the charge that the operator asked for."""
        if self.virtual_charge is not None:
            self.battery.set_charge(self.virtual_charge * self.capacity_ah)

    def on_truth(self, truth: DriveState) -> None:
        """Drain the battery."""
        self.battery.drain(truth)

    def tick(self) -> None:
        """Publish and checkpoint the battery's state; without a base, only if its charge was set manually."""
        if self.world.truth is None and self.virtual_charge is None:
            self.status = "waiting for the simulated base"
            return
        stamp = self.world.stamp if self.world.truth else self.now()
        reading = self.battery.read()
        percentage = reading.charge_ah / reading.capacity_ah
        self.publish(
            BatteryState(
                header=Header(stamp=stamp, frame_id="base_link"),
                voltage=reading.voltage_v,
                temperature=math.nan,
                current=-reading.current_a,
                charge=reading.charge_ah,
                capacity=reading.capacity_ah,
                design_capacity=reading.capacity_ah,
                percentage=percentage,
                power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
                power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_LION,
                present=True,
            ),
            topic="battery",
        )
        self.checkpoint({"charge_ah": reading.charge_ah})
        self.status = f"{percentage:.0%}, {reading.voltage_v:.1f} V, {reading.current_a:.1f} A"
