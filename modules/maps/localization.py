"""Localisation: where the robot is on a given map."""

from pathlib import Path

import numpy as np

from robbie_mp import Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    LaserScan,
    LocalizationState,
    OccupancyGrid,
    Odometry,
    PoseStamped,
    TFMessage,
    TimeJump,
)
from robbie_robots.modules.maps.planar_messages import laser_mount, map_cells, planar, pose_stamped, sweep_of
from robbie_robots.modules.sensor_deadlines import LASER_S, ODOMETRY_S
from robbie_robots.workers.localization.likelihood_field import LikelihoodField
from robbie_robots.workers.localization.localizer import Localization, LocalizationSettings, Localizer
from robbie_robots.workers.maps.map_file import read_map

FEW_UNPLACED = 10
"""After this number of scans in a row that odometry cannot place, something is wrong."""
UNPLACED = "odometry does not know the stamps of the scans: are their clocks set alike?"


class MonteCarloLocalization(Module):
    """Estimates the robot's pose on a map, which comes from a file or a message.

    The module starts without a pose. Once the estimate has converged, it publishes the robot's pose on topic
    `map_pose` with every odometry message; before that, its best guess on `map_pose_guess`. You can publish
    a known pose on `initial_pose`. The particles survive a restart. It is DEGRADED while the stamps of the
    scans do not fit those of odometry, because it then goes by odometry alone.
    """

    map_file: Path | None = setting(None, "map (YAML of ROS's map_server); null: use OccupancyGrid messages")
    max_particles: int = setting(5_000, "maximum number of particles", minimum=100, maximum=100_000)
    scan_topic: str = setting("", "topic of the laser to use, if the robot has several; '' for any")
    seed: int = setting(0, "random seed")

    def setup(self) -> None:
        """Read the map file, if there is one, and subscribe."""
        self.localizer: Localizer | None = None
        self.laser_pose = np.zeros(3)
        self.unplaced = 0
        self.status = "waiting for the map"
        if self.map_file is not None:
            there = read_map(self.map_file)
            self._take_map(LikelihoodField(there.cells, there.resolution_m, there.corner_xy_m))
        else:
            self.subscribe(OccupancyGrid, self.on_map, MessageHandling.KEEP_ONLY_NEWEST)
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self.subscribe(Odometry, self.on_odometry, topic="odom", deadline_s=ODOMETRY_S)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(LaserScan, self.on_scan, newest, topic=self.scan_topic, deadline_s=LASER_S)
        self.subscribe(TFMessage, self.on_transforms, topic="tf_static", optional=True)
        self.subscribe(PoseStamped, self.on_initial_pose, topic="initial_pose", optional=True)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Localise on a new map from now on."""
        self._take_map(LikelihoodField(*map_cells(grid)))

    def on_transforms(self, message: TFMessage) -> None:
        """Take the laser's mounting pose."""
        mount = laser_mount(message)
        if mount is not None:
            self.laser_pose = mount
            if self.localizer is not None:
                self.localizer.laser_pose = mount

    def on_initial_pose(self, message: PoseStamped) -> None:
        """Restart localisation near a given pose."""
        if self.localizer is not None:
            self.localizer.start_at(planar(message.pose))
            self.log.info("restarted near %.2f m, %.2f m, %.2f rad", *planar(message.pose))

    def on_time_jump(self, jump: TimeJump) -> None:
        """Restart globally: the robot may be anywhere after a time jump."""
        if self.localizer is not None:
            self.localizer.start_anywhere()
        self.checkpoint({})

    def on_odometry(self, odometry: Odometry) -> None:
        """Move the particles by odometry and publish the pose."""
        if self.localizer is None:
            return
        self.localizer.add_odometry(odometry.header.stamp.nanoseconds / 1e9, planar(odometry.pose.pose))
        pose, newest = self.localizer.pose, self.localizer.newest
        if pose is not None and newest is not None:
            topic = "map_pose" if newest.converged else "map_pose_guess"
            self.publish(pose_stamped(pose, Header(stamp=odometry.header.stamp, frame_id="map")), topic=topic)

    def on_scan(self, scan: LaserScan) -> None:
        """Update the particles with a scan."""
        if self.localizer is None:
            return
        before = self.localizer.newest
        stamp_s = scan.header.stamp.nanoseconds / 1e9
        self.localizer.add_scan(stamp_s, sweep_of(scan))
        newest = self.localizer.newest
        self.unplaced = self.localizer.unplaced
        self.degraded = UNPLACED if self.localizer.unplaced_in_a_row >= FEW_UNPLACED else ""
        if newest is not None and newest is not before:
            self._publish_state(newest)
            self.checkpoint(self.localizer.state())

    def _take_map(self, field: LikelihoodField) -> None:
        if self.localizer is not None:
            self.localizer.field = field
            return
        settings = LocalizationSettings(max_particles=self.max_particles)
        self.localizer = Localizer(field, settings, self.laser_pose, self.seed)
        if self.restored is not None:
            self.localizer.restore(self.restored)
        self.status = "waiting for laser and odometry"

    def _publish_state(self, newest: Localization) -> None:
        self.publish(
            LocalizationState(
                header=Header(stamp=Time.from_nanoseconds(round(newest.stamp_s * 1e9)), frame_id="map"),
                converged=newest.converged,
                spread_m=newest.spread_m,
                spread_rad=newest.spread_rad,
                agreement=newest.agreement,
                particles=newest.particles,
            )
        )
        self.show_state("CONVERGED" if newest.converged else "SEARCHING")
        unplaced = f"; {self.unplaced} scans without odometry" if self.unplaced else ""
        self.status = (
            f"spread {newest.spread_m:.2f} m, {newest.spread_rad:.2f} rad; {newest.agreement:.0%} of returns "
            f"on the map; {newest.particles} particles{unplaced}"
        )
