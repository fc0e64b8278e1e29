"""Navigation: drives the robot to goals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modules.planar_messages import angles_rad, laser_mount, map_cells, planar, pose_stamped
from robbie_mp import Duration, Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    CancelGoal,
    DriveCommand,
    EmergencyStop,
    LaserScan,
    NavigationState,
    OccupancyGrid,
    Path,
    Pose,
    PoseStamped,
    TFMessage,
    TimeJump,
)
from workers.laser.laser_sweep import LaserSweep
from workers.navigation.collision_guard import CollisionGuard
from workers.navigation.navigator import Navigator
from workers.navigation.navigator_states import RESTING, NavigatorSettings, NavigatorState
from workers.navigation.path_follower import FollowerSettings, PathFollower

MAP_FRAMES = ("map", "")


class Navigation(Module):
    """Drives to poses received on topic `goal`, using map, pose and laser.

    Publishes `DriveCommand`, which expires, only while there is a goal; the planned path as `Path` on topic
    `path`; and `NavigationState` on each change and every `state_period_s`. A new goal replaces the old one;
    `CancelGoal` ends it. The goal survives a restart.
    """

    period_s: float = setting(0.06, "time between drive commands", minimum=0.01)
    command_valid_for_s: float = setting(
        0.3, "the drive stops when no newer command arrives within this time", minimum=0.01
    )
    max_linear_m_per_s: float = setting(0.5, "maximum forward speed", minimum=0.05, changeable=True)
    clearance_m: float = setting(
        0.27, "distance of planned paths from obstacles to the robot's centre", minimum=0.05
    )
    tight_clearance_m: float = setting(
        0.22, "clearance used when no other path leads to the goal", minimum=0.05
    )
    tolerance_m: float = setting(0.25, "distance at which a goal counts as reached", minimum=0.01)
    heading_tolerance_rad: float = setting(
        0.15, "tolerance of the goal's heading; pi: any heading", minimum=0.02
    )
    stale_s: float = setting(0.6, "the robot stops when pose or laser is older than this", minimum=0.05)
    max_recoveries: int = setting(6, "recovery attempts before the goal is given up", minimum=0)
    state_period_s: float = setting(0.5, "time between NavigationState messages", minimum=0.05)

    def setup(self) -> None:
        """Subscribe; the first scan creates the navigator."""
        self.navigator: Navigator | None = None
        self.laser_pose = np.zeros(3)
        self.grid: OccupancyGrid | None = None
        self.goal: Sequence[float] | None = self.restored
        self.published: tuple[str, str] = ("", "")
        self.published_s = -np.inf
        self.path = np.empty((0, 2))
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self.subscribe(PoseStamped, self.on_goal, topic="goal", optional=True)
        self.subscribe(CancelGoal, self.on_cancel, optional=True)
        self.subscribe(OccupancyGrid, self.on_map, newest)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(LaserScan, self.on_scan, newest)
        self.subscribe(TFMessage, self.on_transforms, topic="tf_static", optional=True)
        self.subscribe(EmergencyStop, self.on_emergency_stop, newest, topic="emergency_stop_state")

    def on_goal(self, goal: PoseStamped) -> None:
        """Drive to a new goal from now on."""
        self.goal = planar(goal.pose)
        if goal.header.frame_id not in MAP_FRAMES:
            self._refuse(f"a goal must be given in the frame 'map', not {goal.header.frame_id!r}")
        elif not np.isfinite(self.goal).all():
            self._refuse(f"a goal must have finite coordinates, not {self.goal}")
        else:
            self.log.info("goal: %.2f m, %.2f m, %.2f rad, from %s", *self.goal, self.envelope.sender)
            if self.navigator is not None:
                self.navigator.go_to(self.goal)
            self.checkpoint(list(self.goal))

    def on_cancel(self, cancel: CancelGoal) -> None:
        """Forget the goal and stop the drive at once, without waiting for the last command to expire."""
        if self.goal is None:
            return
        self.goal = None
        self.checkpoint(None)
        if self.navigator is not None:
            self.navigator.cancel(cancel.reason)
            self._command(0.0, 0.0)
        self.tick()

    def on_time_jump(self, jump: TimeJump) -> None:
        """Forget the goal and all obstacles: they are no longer valid."""
        self.goal, self.navigator = None, None
        self.checkpoint(None)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Plan on a new map."""
        self.grid = grid
        if self.navigator is not None:
            self.navigator.see_map(*map_cells(grid))

    def on_pose(self, pose: PoseStamped) -> None:
        """Pass the robot's pose to the navigator."""
        if self.navigator is not None:
            stamp_s = pose.header.stamp.nanoseconds / 1e9
            self.navigator.see_pose(planar(pose.pose), stamp_s, self._published_s())

    def on_transforms(self, message: TFMessage) -> None:
        """Take the laser's mounting pose."""
        mount = laser_mount(message)
        if mount is None or np.array_equal(mount, self.laser_pose):
            return
        if self.navigator is not None and self.navigator.state in RESTING:
            self.goal = None
        self.laser_pose, self.navigator = mount, None

    def on_scan(self, scan: LaserScan) -> None:
        """Pass a scan to the navigator; the first scan defines the laser's geometry."""
        if self.navigator is None:
            self.navigator = self._make_navigator(scan)
        sweep = LaserSweep.from_ranges(
            scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max
        )
        self.navigator.see_sweep(sweep, scan.ranges, scan.header.stamp.nanoseconds / 1e9, self._published_s())

    def on_emergency_stop(self, message: EmergencyStop) -> None:
        """Pass the emergency stop's state to the navigator."""
        if self.navigator is not None:
            self.navigator.see_emergency_stop((message.reason or "no reason given") * message.engaged)

    def setting_changed(self, name: str) -> None:
        """Apply a new maximum speed."""
        if self.navigator is not None:
            self.navigator.follower.settings = self._follower_settings()

    def tick(self) -> None:
        """Command the drive and publish the state."""
        if self.navigator is None:
            waiting = NavigatorState.IDLE if self.goal is None else NavigatorState.STOPPED_NO_LASER
            self._publish_state(waiting.name, "no scan has arrived yet", None)
            self.status = "waiting for the laser"
            return
        speeds = self.navigator.drive()
        if speeds is not None:
            self._command(*speeds)
        if self.navigator.path is not self.path:
            self._publish_path(self.navigator.path)
        if self.navigator.state in RESTING and self.published[0] != self.navigator.state.name:
            self.checkpoint(None)
            self.log.info("%s: %s", self.navigator.state.name, self.navigator.machine.reason)
        self._publish_state(
            self.navigator.state.name, self.navigator.machine.reason, self.navigator.distance_left_m
        )
        self.status = self.navigator.status

    def _command(self, linear_m_per_s: float, angular_rad_per_s: float) -> None:
        self.publish(
            DriveCommand(
                header=Header(stamp=self._now(), frame_id="base_link"),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=Duration.from_nanoseconds(round(self.command_valid_for_s * 1e9)),
            )
        )

    def _make_navigator(self, scan: LaserScan) -> Navigator:
        """Make the navigator for the laser's geometry, with the map and the goal known so far."""
        settings = NavigatorSettings(
            clearance_m=self.clearance_m,
            tight_clearance_m=self.tight_clearance_m,
            tolerance_m=self.tolerance_m,
            heading_tolerance_rad=self.heading_tolerance_rad,
            stale_s=self.stale_s,
            max_recoveries=self.max_recoveries,
        )
        guard = CollisionGuard(angles_rad(scan), self.laser_pose)
        follower = PathFollower(self._follower_settings())
        navigator = Navigator(self._time_s, guard, follower, settings, self.laser_pose)
        if self.grid is not None:
            navigator.see_map(*map_cells(self.grid))
        if self.goal is not None:
            navigator.go_to(self.goal)
        return navigator

    def _refuse(self, reason: str) -> None:
        self.log.error("%s", reason)
        self.goal = None
        self.checkpoint(None)
        if self.navigator is None:
            self._publish_state(NavigatorState.UNREACHABLE.name, reason, None)
        else:
            self.navigator.refuse(reason)

    def _publish_path(self, path: NDArray[np.float64]) -> None:
        self.path = path
        header = Header(stamp=self._now(), frame_id="map")
        ahead = np.diff(path, axis=0, append=path[-1:])
        headings = np.arctan2(ahead[:, 1], ahead[:, 0])
        poses = [pose_stamped([*xy, heading], header) for xy, heading in zip(path, headings, strict=True)]
        self.publish(Path(header=header, poses=poses), topic="path")

    def _publish_state(self, state: str, reason: str, left_m: float | None) -> None:
        if self.published == (state, reason) and self._time_s() - self.published_s < self.state_period_s:
            return
        self.published, self.published_s = (state, reason), self._time_s()
        self.show_state(state)
        header = Header(stamp=self._now(), frame_id="map")
        goal = Pose() if self.goal is None else pose_stamped(self.goal, header).pose
        self.publish(
            NavigationState(
                header=header,
                state=state,
                reason=reason,
                goal=goal,
                distance_left_m=-1.0 if left_m is None else left_m,
            )
        )

    def _follower_settings(self) -> FollowerSettings:
        return FollowerSettings(max_linear_m_per_s=self.max_linear_m_per_s)

    def _now(self) -> Time:
        return Time.from_nanoseconds(self.clock.now_ns())

    def _time_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9

    def _published_s(self) -> float:
        return self.envelope.published_ns / 1e9
