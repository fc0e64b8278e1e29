"""The robot's inertial measurement unit."""

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Header, setting
from robbie_mp.messages import Imu, Vector3
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.simulation.imu import SimulatedImu
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice

# ROS's convention for a message without orientation.
NO_ORIENTATION = np.array([-1.0] + [0.0] * 8)


class SimulatedImuModule(SimulatedDevice):
    """A simulated IMU: publishes a sample on topic `imu` for each true pose from the base."""

    seed: int = setting(0, "random seed of noise and biases")

    def setup(self) -> None:
        """Create the IMU."""
        self.imu = SimulatedImu(self.seed)
        self.samples = 0
        self.world = SharedWorld(self, self.on_truth)
        self.status = "waiting for the simulated base"

    def on_truth(self, truth: DriveState) -> None:
        """Publish what the IMU measured."""
        if not self.imu.move(truth):
            return
        sample = self.imu.read()
        self.publish(
            Imu(
                header=Header(stamp=self.world.stamp, frame_id="imu"),
                orientation_covariance=NO_ORIENTATION,
                angular_velocity=axes(sample.turn_rad_per_s),
                linear_acceleration=axes(sample.acceleration_m_per_s2),
            ),
            topic="imu",
        )
        self.samples += 1
        self.status = f"{self.samples} samples"


def axes(values: NDArray[np.float64]) -> Vector3:
    """Return the vector of three values."""
    return Vector3(**dict(zip("xyz", values.tolist(), strict=True)))
