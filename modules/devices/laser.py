"""The robot's laser range finder."""

import math
from dataclasses import replace

import numpy as np

from robbie_mp import Header, SettingError, setting
from robbie_mp.messages import LaserScan
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.laser import LaserFailure, LaserSilent, SimulatedLaser
from robbie_robots.hw.simulation.people import leg_circles
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice

ROBOT_RADIUS_M = DifferentialDrive().body_radius_m


class SimulatedLaserRangeFinder(SimulatedDevice):
    """A simulated laser; it gets the robot's true pose from the simulated base.

    A robot may have several: give each its `frame_id` and `mount`, and by the profile's `topics` its topic.
    """

    seed: int = setting(0, "random seed of the noise")
    noise_m: float = setting(0.01, "standard deviation of a range", minimum=0.0)
    range_max_m: float = setting(10.0, "maximum range", minimum=0.1)
    period_s: float = setting(0.1, "time between scans", minimum=0.005)
    angle_min_rad: float = setting(-math.pi, "direction of the first step")
    angle_increment_rad: float = setting(math.pi / 180, "angle from step to step", minimum=1e-4)
    steps: int = setting(360, "number of measured directions", minimum=1, maximum=10_000)
    merge: int = setting(
        1, "steps that become one beam, the nearest of their ranges, as in Hokuyo lasers", minimum=1
    )
    frame_id: str = setting("laser", "name of the laser's frame")
    mount: list[float] = setting(
        [], "x, y (m) and heading (rad) of the laser on the robot; []: in its middle, looking ahead"
    )
    virtual_failure: LaserFailure = setting(
        LaserFailure.NONE,
        "simulated failure: silent sends nothing, blind sees nothing, frozen repeats its last sweep",
        changeable=True,
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Report a wrong mounting pose before anything starts."""
        super().check(settings)
        mount = settings["mount"]
        assert isinstance(mount, list)
        if len(mount) not in (0, 3):
            raise SettingError(f"expected x, y (m) and heading (rad), not {mount}", "mount")

    def setup(self) -> None:
        """Create the laser; it measures nothing until the simulated base has published its pose."""
        geometry = LaserGeometry(
            angle_min_rad=self.angle_min_rad,
            angle_increment_rad=self.angle_increment_rad,
            beams=self.steps,
            range_max_m=self.range_max_m,
            mount=Pose(*self.mount) if self.mount else ORIGIN,
        )
        self.world = SharedWorld(self)
        self.laser = SimulatedLaser(self.world.arena, geometry, noise_m=self.noise_m, seed=self.seed)
        self.laser.failure = self.virtual_failure
        self.places = self.robot_places()
        self.scans = 0

    def setting_changed(self, _name: str) -> None:
        """Start or end the simulated failure."""
        self.laser.failure = self.virtual_failure

    def tick(self) -> None:
        """Publish a scan."""
        truth = self.world.truth
        if truth is None:
            self.status = "waiting for the simulated base"
            return
        self.laser.arena = self.world.arena.with_circles(leg_circles(self.world.people))
        if self.places is not None:
            self.laser.arena = self.laser.arena.with_robots(self.places.others(), ROBOT_RADIUS_M)
        self.laser.place(truth.pose, truth.stamp_s)
        try:
            sweep = self.laser.scan()
        except LaserSilent:
            self.status = f"{self.scans} scans, failure: silent"
            return
        geometry = merged_geometry(self.laser.geometry, self.merge)
        self.publish(
            LaserScan(
                header=Header(stamp=self.world.stamp, frame_id=self.frame_id),
                angle_min=geometry.angle_min_rad,
                angle_max=geometry.angle_max_rad,
                angle_increment=geometry.angle_increment_rad,
                scan_time=self.period_s,
                range_min=geometry.range_min_m,
                range_max=geometry.range_max_m,
                ranges=np.minimum.reduceat(sweep.ranges_m, range(0, self.steps, self.merge)),
            )
        )
        self.scans += 1
        failure = "" if self.virtual_failure is LaserFailure.NONE else f", failure: {self.virtual_failure}"
        self.status = f"{self.scans} scans of {geometry.beams} beams{failure}"


def merged_geometry(fine: LaserGeometry, merge: int) -> LaserGeometry:
    """Return the beams of a laser that merges neighbouring steps; what is left over is a beam, too."""
    return replace(
        fine,
        angle_min_rad=fine.angle_min_rad + (merge - 1) / 2 * fine.angle_increment_rad,
        angle_increment_rad=fine.angle_increment_rad * merge,
        beams=-(-fine.beams // merge),
    )
