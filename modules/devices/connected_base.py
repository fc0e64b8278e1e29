"""Bases on a serial line or a TCP port."""

import math

from robbie_mp import Header, Time, setting
from robbie_mp.messages import BatteryState, Bumper
from robbie_robots.hw.connected_base import BaseReading, ConnectedBase
from robbie_robots.hw.irobot.create import BIT_RATE as CREATE_BIT_RATE
from robbie_robots.hw.irobot.create import CreateBase
from robbie_robots.hw.pioneer.base import BIT_RATE as PIONEER_BIT_RATE
from robbie_robots.hw.pioneer.base import STANDS_WITHIN_S, PioneerBase
from robbie_robots.modules.devices.commanded_base import CommandedBase, odometry
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule

# A battery changes slowly: it is told at this interval.
BATTERY_PERIOD_S = 1.0
CONFIRM_PERIOD_S = 0.2
"""Modules that start, such as an arm, must soon hear of an emergency stop, also while there is no base."""


class ConnectedBaseModule(CommandedBase, PluggableDeviceModule[BaseReading]):
    """Base of the modules of real bases.

    A drive command expires: if no newer one arrives in time, the base stops, even if this process has died
    or hangs. After the base was unplugged it stands until the next command. An emergency stop latches and
    survives a restart and a replug.

    Publishes `Odometry` on `odom`, `Bumper` on `bumper`, `BatteryState` on `battery`, `EmergencyStop` on
    `emergency_stop_state`, and `DeviceState` on a topic named after the module. Without the base it
    publishes only the last two.
    """

    drive: ConnectedBase
    # It may have been started again by itself, after a failure of the whole robot.
    starts_in_auto: bool = setting(
        False, "true: modules drive the robot from the start, without an order to go on"
    )
    # Its time is the machine's: commands of a log that is played rest on what was long ago.
    follows_run_clock = False
    # Commands wait for the end of a look at the device.
    wait_s = 0.0

    def setup(self) -> None:
        """Create the driver, with the emergency stop that was engaged before a restart."""
        super().setup()
        assert isinstance(self.device, ConnectedBase)
        self.drive = self.device
        self.stop_reason = ""
        if self.restored is not None and self.restored["is_emergency_stopped"]:
            self.drive.stop_for_emergency()
            self.stop_reason = "engaged before a restart"
        self.battery_due_s = self.confirm_due_s = -math.inf
        self.problems: tuple[str, ...] = ()
        self.obey()

    def tick(self) -> None:
        """Publish what the base has reported, who controls it, and whether it is stopped."""
        super().tick()
        self.look_after_control()
        if self.monotonic_s() >= self.confirm_due_s:
            self.confirm_due_s = self.monotonic_s() + CONFIRM_PERIOD_S
            self.confirm()

    def confirm(self) -> None:
        """Checkpoint and publish the emergency stop's state, so that it survives a restart."""
        self.checkpoint(
            {
                "is_emergency_stopped": self.drive.is_emergency_stopped,
                "control": self.control.memory(),
            }
        )
        super().confirm()

    def on_value(self, value: BaseReading) -> None:
        """Publish what the base has reported."""
        stamp = Time.from_nanoseconds(round(value.state.stamp_s * 1e9))
        self.publish(odometry(value.state, stamp, "odom", value.covariance), topic="odom")
        header = Header(stamp=stamp, frame_id="base_link")
        self.publish(Bumper(header=header, pressed=list(value.pressed)), topic="bumper")
        if value.state.stamp_s >= self.battery_due_s:
            self.battery_due_s = value.state.stamp_s + BATTERY_PERIOD_S
            if value.battery is not None:
                self.publish(battery_state(value, header), topic="battery")
        if value.problems != self.problems:
            self.problems = value.problems
            self.log.info("the base reports: %s", ", ".join(value.problems) or "no more problems")

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.device.is_connected:
            return super().status_line()
        stopped = "EMERGENCY STOP, " if self.drive.is_emergency_stopped else ""
        problems = "".join(f", {problem}" for problem in self.problems)
        figures = (
            f"{super().status_line()}, {self.drive.expired_commands} expired commands, "
            f"{self.drive.guards_replaced} guards replaced"
        )
        return f"{stopped}{self.control_status}{figures}{problems}"


class CreateModule(ConnectedBaseModule):
    """An iRobot Create 2 or Roomba 600: see `ConnectedBaseModule`."""

    bit_rate: int = setting(CREATE_BIT_RATE, "bit/s; 57600 for Create 1 and Roomba 400", minimum=300)

    def open_device(self) -> CreateBase:
        """Return the driver."""
        return CreateBase(self.url, self.bit_rate, clock=self.time_s)


class PioneerModule(ConnectedBaseModule):
    """A Pioneer robot: see `ConnectedBaseModule`."""

    bit_rate: int = setting(PIONEER_BIT_RATE, "bit/s of the robot's port", minimum=300)
    stands_within_s: float = setting(
        STANDS_WITHIN_S,
        "drive no faster than lets the robot stand this long after the loss of its line; 0: drive freely",
        minimum=0.0,
    )

    def open_device(self) -> PioneerBase:
        """Return the driver."""
        return PioneerBase(self.url, self.bit_rate, stands_within_s=self.stands_within_s, clock=self.time_s)


def battery_state(value: BaseReading, header: Header) -> BatteryState:
    """Return the message on a base's battery; what the base does not measure is NaN."""
    battery = value.battery
    assert battery is not None
    known = battery.capacity_ah > 0
    charging = {
        None: BatteryState.POWER_SUPPLY_STATUS_UNKNOWN,
        True: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
        False: BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
    }[value.charging]
    return BatteryState(
        header=header,
        voltage=battery.voltage_v,
        temperature=math.nan,
        current=-battery.current_a,
        charge=battery.charge_ah,
        capacity=battery.capacity_ah,
        design_capacity=math.nan,
        percentage=battery.charge_ah / battery.capacity_ah if known else math.nan,
        power_supply_status=charging,
        present=True,
    )
