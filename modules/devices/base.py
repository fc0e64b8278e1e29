"""The robot's base: passes drive commands to the drive and publishes wheel odometry."""

from robbie_mp import setting
from robbie_robots.hw.simulation.differential_drive import RobotBody
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.modules.devices.commanded_base import CommandedBase, odometry
from robbie_robots.modules.devices.true_base import TrueBase, state_of


class SimulatedBase(CommandedBase, TrueBase):
    """The base of a simulated robot. It also publishes the robot's true pose, on topic `ground_truth`.

    The map frame has its origin at the robot's start, as a real robot's odometry does.

    A drive command expires: if no newer one arrives in time, the drive stops, even if the module that sent
    it has died. An emergency stop latches and survives a restart: the robot stands still until it receives
    an `EmergencyStop` with `engaged` false. After a restart of the base, the robot is at rest where it was
    at the last tick.

    Publishes `Odometry` on `odom` and `ground_truth`, `EmergencyStop` on `emergency_stop_state`, and, if the
    arena has temporary obstacles, `SimulatedWorld` on `ground_truth`.
    """

    drive: SimulatedDrive

    body: RobotBody = setting(RobotBody.STOCK, "geometry and limits: the stock robot's, or a Create 2's")

    def setup(self) -> None:
        """Put the robot at the arena's start, or where it was before the restart."""
        self.enter_arena(self.body.drive)
        self.stop_reason = "engaged before a restart" if self.drive.is_emergency_stopped else ""
        self.obey()

    def tick(self) -> None:
        """Publish odometry, the true pose and the emergency stop's state; checkpoint them."""
        self.look_after_control()
        state, truth = self.drive.read(), self.drive.ground_truth()
        stamp = self.now()
        self.publish(odometry(state, stamp, "odom"), topic="odom")
        self.publish_truth(truth, stamp)
        self.confirm()
        self.status = (
            f"{'EMERGENCY STOP, ' if self.drive.is_emergency_stopped else ''}{self.control_status}"
            f"{state.linear_m_per_s:.2f} m/s, {state.angular_rad_per_s:.2f} rad/s, "
            f"{self.drive.collisions} collisions, {self.drive.expired_commands} expired commands"
        )

    def confirm(self) -> None:
        """Checkpoint the world and publish the emergency stop's state, so that both survive a restart."""
        self.checkpoint({**state_of(self.drive.world_state()), "control": self.control.memory()})
        super().confirm()

    def teardown(self) -> None:
        """Stop the robot; write collisions, expired commands and distance from the start to `base.json`."""
        self.drive.stop()
        self.write_results()
