"""Emulated inertial measurement units on pseudo-terminals, with the simulated robot's motion behind them."""

from abc import abstractmethod

from robbie_mp import setting
from robbie_mp.messages import Quaternion
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.mip import EmulatedMip
from robbie_robots.hw.emulation.xsens import EmulatedMti
from robbie_robots.hw.imu import ImuSample
from robbie_robots.hw.microstrain.imu import AXES, with_z_up
from robbie_robots.hw.microstrain.mip import STANDARD_GRAVITY_M_PER_S2
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.imu import SimulatedImu
from robbie_robots.modules.devices.emulated import EmulatedDeviceModule
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice


class EmulatedImu(SimulatedDevice, EmulatedDeviceModule):
    """A unit on a serial line that measures how the simulated robot moves.

    It sends at the rate that its driver chooses; it measures as often as the base publishes its true pose.
    The heading that it tells is the true one.
    """

    seed: int = setting(0, "random seed of noise and biases")

    def setup(self) -> None:
        """Plug the unit in; until the robot's first motion it tells that it rests."""
        self.imu = SimulatedImu(self.seed)
        self.samples = 0
        self.plug_in(self.create_device())
        self.world = SharedWorld(self, self.on_truth)

    @abstractmethod
    def create_device(self) -> EmulatedDevice:
        """Return the unit."""

    @abstractmethod
    def measure(self, sample: ImuSample, pose: Pose) -> None:
        """Let the unit measure this from now on; the pose is the robot's true one."""

    def on_truth(self, truth: DriveState) -> None:
        """Let the unit measure the robot's motion."""
        if self.imu.move(truth):
            self.measure(self.imu.read(), truth.pose)
            self.samples += 1
        self.status = f"{self.line_status}, {self.samples} motions"

    def teardown(self) -> None:
        """Pull the unit out."""
        self.pull_out()


class EmulatedXsensImu(EmulatedImu):
    """An Xsens MTi: see `EmulatedImu`."""

    def create_device(self) -> EmulatedMti:
        """Return the unit."""
        self.mti = EmulatedMti()
        return self.mti

    def measure(self, sample: ImuSample, pose: Pose) -> None:
        """Let the unit measure this from now on."""
        motion = self.mti.motion
        motion.turn = tuple(sample.turn_rad_per_s.tolist())
        motion.acceleration = tuple(sample.acceleration_m_per_s2.tolist())
        motion.quaternion = heading(pose)


class EmulatedMicroStrainImu(EmulatedImu):
    """A MicroStrain unit with MIP: see `EmulatedImu`."""

    def create_device(self) -> EmulatedMip:
        """Return the unit."""
        self.mip = EmulatedMip()
        return self.mip

    def measure(self, sample: ImuSample, pose: Pose) -> None:
        """Let the unit measure this from now on."""
        motion = self.mip.motion
        motion.turn = tuple((AXES * sample.turn_rad_per_s).tolist())
        motion.acceleration = tuple(
            (AXES * sample.acceleration_m_per_s2 / STANDARD_GRAVITY_M_PER_S2).tolist()
        )
        motion.quaternion = tuple(with_z_up(heading(pose)).tolist())


def heading(pose: Pose) -> tuple[float, ...]:
    """Return a pose's heading as a quaternion: w, x, y, z."""
    turned = Quaternion.from_yaw(pose.heading_rad)
    return turned.w, turned.x, turned.y, turned.z
