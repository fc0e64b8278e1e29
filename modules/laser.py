"""The robot's laser range finder."""

from pathlib import Path

from hw.arena_file import read_arena
from hw.laser import LaserGeometry
from hw.pose import Pose
from hw.simulated_laser import SimulatedLaser
from robbie_mp.messages import Header, LaserScan, Odometry, Time
from robbie_mp.module import MessageHandling, Module, setting
from robbie_mp.settings import REQUIRED


class SimulatedLaserRangeFinder(Module):
    """A simulated laser; it learns from the simulated base where the robot really is."""

    arena: Path = setting(REQUIRED, "the world the robot drives in (YAML)", must_exist=True)
    seed: int = setting(0, "of the noise")
    noise_m: float = setting(0.01, "standard deviation of a range", minimum=0.0)
    range_max_m: float = setting(10.0, "farther things are not measured", minimum=0.1)
    period_s: float = setting(0.1, "time between scans", minimum=0.005)

    def setup(self) -> None:
        """Make the laser; it measures nothing until it knows where it is."""
        geometry = LaserGeometry(range_max_m=self.range_max_m)
        arena = read_arena(self.arena)
        self.start = arena.start
        self.laser = SimulatedLaser(arena, geometry, noise_m=self.noise_m, seed=self.seed)
        self.stamp = Time()
        self.scans = 0
        self.subscribe(Odometry, self.on_truth, MessageHandling.KEEP_ONLY_NEWEST, topic="ground_truth")

    def on_truth(self, truth: Odometry) -> None:
        """Go where the robot is."""
        position = truth.pose.pose.position
        self.stamp = truth.header.stamp
        robot = Pose(position.x, position.y, truth.pose.pose.orientation.yaw)
        self.laser.place(self.start.plus(robot), self.stamp.nanoseconds / 1e9)

    def tick(self) -> None:
        """Publish a scan."""
        if not self.laser.is_placed:
            self.status = "waits for the simulated base"
            return
        sweep = self.laser.scan()
        geometry = self.laser.geometry
        self.publish(
            LaserScan(
                header=Header(stamp=self.stamp, frame_id="laser"),
                angle_min=geometry.angle_min_rad,
                angle_max=geometry.angle_max_rad,
                angle_increment=geometry.angle_increment_rad,
                scan_time=self.period_s,
                range_min=geometry.range_min_m,
                range_max=geometry.range_max_m,
                ranges=sweep.ranges_m,
            )
        )
        self.scans += 1
        self.status = f"{self.scans} scans of {geometry.beams} beams"
