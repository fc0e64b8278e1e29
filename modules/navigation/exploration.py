"""The demo's application control module: explores the arena, drives home, and ends the run."""

import math

from robbie_mp import Duration, Header, MessageHandling, Time, setting
from robbie_mp.messages import ControlState, DriveCommand, LaserScan, OccupancyGrid, PoseStamped
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.modules.maps.planar_messages import map_cells, sweep_of
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.workers.exploration.explorer import Explorer
from robbie_robots.workers.exploration.explorer_states import ExplorerSettings
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.path_follower import FollowerSettings, PathFollower

LATE_S = 0.4
"""Pose and laser must keep coming at least this often."""


class Exploration(MovingModule):
    """Drives the robot by map and laser until nothing is left to explore.

    Home, the time used, and whether the robot was on its way home survive a restart.
    """

    period_s: float = setting(0.06, "time between drive commands", minimum=0.01)
    command_valid_for_s: float = setting(
        0.3,
        "the drive stops when no newer command arrives within this time",
        minimum=0.01,
        maximum=MAX_VALID_FOR_S,
    )
    max_linear_m_per_s: float = setting(0.7, "maximum forward speed", minimum=0.05)
    scan_topic: str = setting("", "topic of the laser to use, if the robot has several; '' for any")
    time_limit_s: float = setting(
        33.0, "after this time the robot drives home, even if something is left to explore", minimum=1.0
    )
    returns_home: bool = setting(True, "drive back to the start at the end")

    def setup(self) -> None:
        """Subscribe; the first scan creates the explorer."""
        self.explorer: Explorer | None = None
        self.hold = ""
        self.before = self.restored or {"home_xy_m": None, "exploring_ended": None, "used_s": 0.0}
        self.began_s = self.monotonic_s()
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(OccupancyGrid, self.on_map, newest)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose", deadline_s=LATE_S)
        self.subscribe(LaserScan, self.on_scan, newest, topic=self.scan_topic, deadline_s=LATE_S)
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass a new map to the explorer."""
        if self.explorer is not None:
            self.explorer.see_map(*map_cells(grid))

    def on_pose(self, pose: PoseStamped) -> None:
        """Pass the robot's pose to the explorer."""
        if self.explorer is not None:
            position = pose.pose.position
            place = position.x, position.y, pose.pose.orientation.yaw
            self.explorer.see_pose(place, pose.header.stamp.nanoseconds / 1e9, self._published_s())

    def on_scan(self, scan: LaserScan) -> None:
        """Pass a scan to the explorer; the first one creates it."""
        if self.explorer is None:
            left_s = self.time_limit_s - self.before["used_s"]
            settings = ExplorerSettings(time_limit_s=left_s, returns_home=self.returns_home)
            self.explorer = Explorer(
                self.monotonic_s,
                CollisionGuard(),
                settings,
                PathFollower(FollowerSettings(max_linear_m_per_s=self.max_linear_m_per_s)),
                home_xy_m=self.before["home_xy_m"],
            )
            self.explorer.exploring_ended = self.before["exploring_ended"]
            self.explorer.see_hold(self.hold)
        stamp_s = scan.header.stamp.nanoseconds / 1e9
        self.explorer.see_sweep(sweep_of(scan), stamp_s, self._published_s())

    def on_control(self, control: ControlState) -> None:
        """Pass to the explorer whether the robot may drive by itself."""
        self.hold = "" if control.mode == ControlState.AUTO else control.reason or "no reason given"
        if self.explorer is not None:
            self.explorer.see_hold(self.hold)

    def act(self) -> None:
        """Command the drive; end the module when the task has ended."""
        if self.explorer is None:
            self.status = "waiting for the laser"
            return
        linear_m_per_s, angular_rad_per_s = self.explorer.drive()
        rests_on_s = self.explorer.rests_on_s
        self.publish(
            DriveCommand(
                header=Header(stamp=self.now(), frame_id="base_link"),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=Duration.from_nanoseconds(round(self.command_valid_for_s * 1e9)),
                based_on=Time() if math.isinf(rests_on_s) else Time.from_nanoseconds(round(rests_on_s * 1e9)),
            )
        )
        ended = self.explorer.exploring_ended
        self.checkpoint(
            {
                "home_xy_m": self.explorer.home_xy_m,
                "exploring_ended": ended and str(ended),
                "used_s": self.before["used_s"] + self.monotonic_s() - self.began_s,
            }
        )
        self.status = self.explorer.status
        self.show_state(self.explorer.state)
        if self.explorer.machine.is_final:
            self.log.info("exploration ended: %s", self.status)
            self.stop()

    def _published_s(self) -> float:
        return self.envelope.published_ns / 1e9
