"""Mapping: builds a map from odometry and laser scans, and locates the robot in it."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp import Header, MessageHandling, Module, setting
from robbie_mp.bus.checkpoint.errors import CheckpointTooLarge
from robbie_mp.messages import (
    ControlSet,
    ControlState,
    LaserScan,
    MapMetaData,
    MappingState,
    OccupancyGrid,
    Odometry,
    Point,
    Pose,
    SetControl,
    TFMessage,
    TimeJump,
)
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.maps.planar_messages import laser_mount, planar, pose_stamped, sweep_of
from robbie_robots.modules.sensor_deadlines import LASER_S, ODOMETRY_S
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.grid_mapper import GridMapper, MapperLimits
from robbie_robots.workers.maps.map_file import write_large_map
from robbie_robots.workers.maps.map_picture import map_picture
from robbie_robots.workers.row_log import RowLog

MOST_REDRAWN = 1000  # sweeps drawn or moved between two maps; the rest follows with the next ones
MAP_FILE = Path("map.yaml")
BAND_ROWS = 1024
NEW_MAP = "the map was lost: goals and places are of a map with another origin"
MOST_PICTURE_CELLS = 25_000_000


class Mapping(Module):
    """Feeds the mapper every odometry message and every scan, and publishes map and pose.

    How well the robot knows where it is, and what of the map only odometry joins to the rest, goes to
    `MappingState`.

    The pose goes to `map_pose`. While scans do not fit the map, as after a slip of odometry, it goes to
    `map_pose_guess`: do not drive by it.

    On an ordered stop the module writes `map.png` (a picture), `map.yaml` with `map.pgm` (the map in the
    format of ROS's map_server), `trajectory.txt` (lines of `t x y theta`: s, m, m, rad; map frame) and
    `mapping.json` (counters).

    After a restart the module continues from its last checkpoint. Messages handled after that checkpoint are
    neither in the map nor in the counters. The module takes a checkpoint after every scan if that is cheap.
    If no checkpoint is left, it orders the robot to hold, and gives only the guess until the robot does so.
    """

    resolution_m: float = setting(0.05, "edge of a grid cell", minimum=0.005)
    max_range_m: float = setting(30.0, "farther returns are ignored", minimum=0.1)
    period_s: float = setting(1.0, "time between maps", minimum=0.05)
    window_cells: int = setting(
        16_000_000, "largest map published; of a larger one, the part around the robot", minimum=10_000
    )
    key_sweeps: int = setting(
        4000, "scans kept in the map, some 15 kB each; at the limit, redundant ones are removed", minimum=10
    )
    scan_topic: str = setting("", "topic of the laser to use, if the robot has several; '' for any")
    map_topic: str = setting("", "topic of the map, if the robot has other maps, too")
    checkpoint_share: float = setting(
        0.05, "maximum share of its time spent on checkpoints", minimum=1e-6, maximum=1.0
    )
    draw_truth: bool = setting(False, "draw the simulated robot's true path in the picture")

    def setup(self) -> None:
        """Start with an empty map, or with the last checkpoint's map."""
        self._reset()
        self.must_hold = self.checkpoint_lost
        self.hold_order = Errand(self, repeat_s=0.5)
        if self.restored is not None:
            self._restore(self.restored)
            self.must_hold = self.restored["must_hold"]
        self.next_checkpoint_s = 0.0
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self.subscribe(Odometry, self.on_odometry, topic="odom", deadline_s=ODOMETRY_S)
        self.subscribe(LaserScan, self.on_scan, topic=self.scan_topic, deadline_s=LASER_S)
        self.subscribe(TFMessage, self.on_transforms, topic="tf_static", optional=True)
        if self.draw_truth:
            self.subscribe(Odometry, self.on_truth, MessageHandling.KEEP_ONLY_NEWEST, topic="ground_truth")

    def _reset(self) -> None:
        limits = MapperLimits(key_sweeps=self.key_sweeps)
        self.mapper = GridMapper(self.resolution_m, self.max_range_m, limits=limits)
        self.odometry_messages = 0
        self.scans = 0
        self.drawn_scans = 0
        self.true_path = RowLog(2, self.mapper.limits.odometry)

    def on_time_jump(self, jump: TimeJump) -> None:
        """Start a new map, because the robot may be anywhere; keep the laser's mounting pose."""
        laser_pose = self.mapper.laser_pose
        self._reset()
        self.mapper.laser_pose = laser_pose
        self._take_checkpoint()
        self.log.info("started a new map because time jumped (%s)", jump.reason)

    def on_transforms(self, message: TFMessage) -> None:
        """Take the laser's mounting pose, unless mapping has started."""
        mount = laser_mount(message)
        if mount is not None and not self.scans:
            self.mapper.laser_pose = mount

    def on_odometry(self, odometry: Odometry) -> None:
        """Add wheel odometry and publish the robot's pose on the map, or its guess if scans do not fit."""
        self.odometry_messages += 1
        self.mapper.add_odometry(odometry.header.stamp.nanoseconds / 1e9, planar(odometry.pose.pose))
        header = Header(stamp=odometry.header.stamp, frame_id="map")
        is_safe = self.mapper.is_certain and not self.must_hold
        topic = "map_pose" if is_safe else "map_pose_guess"
        self.publish(pose_stamped(self.mapper.pose, header), topic=topic)

    def on_scan(self, scan: LaserScan) -> None:
        """Add a scan."""
        self.scans += 1
        self.mapper.add_scan(scan.header.stamp.nanoseconds / 1e9, self.mapped(sweep_of(scan)))
        if time.monotonic() >= self.next_checkpoint_s:
            self._take_checkpoint()

    def mapped(self, sweep: LaserSweep) -> LaserSweep:
        """Return what of a sweep to put on the map: all of it."""
        return sweep

    def on_truth(self, truth: Odometry) -> None:
        """Record the simulated robot's true position."""
        self.true_path.add(planar(truth.pose.pose)[:2])

    def tick(self) -> None:
        """Publish the map if it has changed; let a robot that has lost its map hold."""
        if self.must_hold:
            order = SetControl(mode=ControlState.HOLD, reason=NEW_MAP)
            self.hold_order.want("hold", order, self._on_held)
        if self.scans == self.drawn_scans and not self.mapper.sweeps_behind:
            return
        self.drawn_scans = self.scans
        cells, corner_m, resolution_m = self.mapper.grid(self.window_cells, MOST_REDRAWN)
        info = MapMetaData(
            resolution=resolution_m,
            width=cells.shape[1],
            height=cells.shape[0],
            origin=Pose(position=Point(x=corner_m[0], y=corner_m[1])),
        )
        stamp = self.now()
        header = Header(stamp=stamp, frame_id="map")
        with self.loan(
            OccupancyGrid, topic=self.map_topic, latched=True, header=header, info=info, data=cells.size
        ) as grid:
            grid.data[:] = cells.ravel()
        certainty = self._publish_state(header)
        self.status = (
            f"{self.scans} scans, {self.odometry_messages} odometry, {self.mapper.loops_closed} loops, "
            f"map {cells.shape[1]}x{cells.shape[0]}, "
            f"position ± {certainty.spread_m:.2f} m"
        )
        if self.mapper.slips_noticed:
            self.status += f", {self.mapper.slips_noticed} slips"
        if self.mapper.gaps_noticed:
            self.status += f", {self.mapper.gaps_noticed} gaps ({self.mapper.gaps_open} open)"
        if not self.mapper.is_certain:
            self.status += ", LOST"
        height, width = self.mapper.known_cells
        if cells.shape != (height, width):
            self.status += f" of {width}x{height}"

    def _publish_state(self, header: Header) -> MappingState:
        """Say how well the robot knows where it is."""
        certainty = self.mapper.certainty()
        variances = np.maximum(np.diag(certainty.covariance), 0.0)
        state = MappingState(
            header=header,
            certain=self.mapper.is_certain,
            spread_m=math.sqrt(variances[:2].sum()),
            spread_rad=math.sqrt(variances[2]),
            covariance=certainty.covariance.ravel(),
            gaps_open=certainty.gaps_open,
            share_beyond_gaps=certainty.share_beyond_gaps,
        )
        self.publish(state, topic=self.map_topic, latched=True)
        return state

    def _on_held(self, _reply: ControlSet) -> None:
        self.must_hold = False

    def _take_checkpoint(self) -> None:
        """Take a checkpoint; the longer it takes, the later the next one."""
        began_s = time.monotonic()
        state = {
            "mapper": self.mapper.state(),
            "odometry_messages": self.odometry_messages,
            "scans": self.scans,
            "true_path": self.true_path.state(),
            "must_hold": self.must_hold,
        }
        try:
            self.checkpoint(state)
        except CheckpointTooLarge as error:
            self.log.warning("no more checkpoints: a restart would lose everything from now on: %s", error)
            self.next_checkpoint_s = math.inf
            return
        cost_s = time.monotonic() - began_s
        self.next_checkpoint_s = began_s + cost_s / self.checkpoint_share

    def _restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint, unless it was taken with other settings."""
        settings = state["mapper"]["settings"]
        if (settings["resolution_m"], settings["max_range_m"]) != (self.resolution_m, self.max_range_m):
            self.log.warning(
                "starting with an empty map because the settings have changed since the last checkpoint"
            )
            return
        self.mapper = GridMapper.from_state(state["mapper"])
        self.mapper.limits = replace(self.mapper.limits, key_sweeps=self.key_sweeps)
        self.odometry_messages = state["odometry_messages"]
        self.scans = state["scans"]
        self.true_path.restore(state["true_path"])
        self.log.info(
            "continuing after %d odometry messages and %d scans", self.odometry_messages, self.scans
        )

    def teardown(self) -> None:
        """Write the results."""
        trajectory = self.mapper.trajectory()
        with self.result_file("trajectory.txt") as file:
            np.savetxt(file, trajectory, ["%.6f", "%.6f", "%.6f", "%.8f"])
        grid = self.mapper.drawn()
        known = grid.known()
        bands = (grid.cells(band)[0] for band in known.bands(BAND_ROWS))
        corner_m = known.low * grid.resolution_m
        write_large_map(MAP_FILE, known.shape, bands, grid.resolution_m, corner_m, self.result_file)
        cells, corner_m, resolution_m = grid.overview(MOST_PICTURE_CELLS)
        picture = map_picture(
            cells,
            corner_m,
            resolution_m,
            estimated_path=trajectory[:, 1:3],
            true_path=self.true_path.rows if len(self.true_path) else None,
        )
        self.write_result("map.png", picture)
        counted = {
            "odometry_messages": self.odometry_messages,
            "scans": self.scans,
            "loops_closed": self.mapper.loops_closed,
            "refused": dict(self.mapper.refused),
            "thinned": self.mapper.thinned,
            "slips_noticed": self.mapper.slips_noticed,
            "slips_not_undone": self.mapper.slips_not_undone,
            "gaps_noticed": self.mapper.gaps_noticed,
            "gaps_open": self.mapper.gaps_open,
            "loops_taken_back": self.mapper.loops_taken_back,
            "odometry_deviation": self.mapper.odometry_deviation.round(3).tolist(),
            "systematic_errors": self.mapper.systematic_errors.round(4).tolist(),
            "map": {
                "width_cells": known.shape[1],
                "height_cells": known.shape[0],
                "grid_bytes": grid.bytes,
            },
        }
        self.write_result("mapping.json", json.dumps(counted, indent=2) + "\n")
