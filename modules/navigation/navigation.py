"""Navigation: drives the robot to goals."""

import math

import numpy as np
from numpy.typing import NDArray

from robbie_mp import (
    ActiveGoal,
    CallRefused,
    Duration,
    Header,
    MessageHandling,
    Module,
    SettingError,
    Time,
    setting,
)
from robbie_mp.messages import (
    CancelNavigation,
    ControlState,
    Costmap,
    CostmapMetaData,
    DriveCommand,
    EmergencyStop,
    LaserScan,
    MapAnnotations,
    MappingState,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
    OccupancyGrid,
    Path,
    PathPlanned,
    PlanPath,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
    TimeJump,
)
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.modules.maps.planar_messages import (
    LASER,
    map_cells,
    planar,
    planar_mounts,
    pose_stamped,
    sweep_of,
)
from robbie_robots.workers.maps.map_annotations import forbid
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.navigator import Navigator, NotReady
from robbie_robots.workers.navigation.navigator_states import RESTING, NavigatorSettings, NavigatorState
from robbie_robots.workers.navigation.path_follower import FollowerSettings, PathFollower
from robbie_robots.workers.navigation.path_planner import cell_costs
from robbie_robots.workers.navigation.way_planner import Obstruction

MAP_FRAMES = ("map", "")

Active = ActiveGoal[NavigateTo, NavigationFeedback, NavigationResult]


class Navigation(Module):
    """Serves `NavigateTo`: drives to a pose or a named place, using map, pose and laser.

    It stays out of the no-go areas of `MapAnnotations`, which name the places, too.

    With several lasers, `scan_topic` names the one that looks ahead, and `more_scan_topics` the others.

    Publishes `DriveCommand`, which expires, only while there is a goal; the planned path as `Path` on topic
    `path`; the `Costmap` on which it was planned on `costmap`; and the goal that it drives to as
    `PoseStamped` on topic `goal`, without a frame when there is none any more. A newer goal takes the
    place of the older one, whose client gets `GoalPreempted`. `CancelNavigation` ends any goal. The goal
    survives a restart: its client notices nothing. `PlanPath` returns a path and does not drive it.
    """

    period_s: float = setting(0.06, "time between drive commands", minimum=0.01)
    command_valid_for_s: float = setting(
        0.3,
        "the drive stops when no newer command arrives within this time",
        minimum=0.01,
        maximum=MAX_VALID_FOR_S,
    )
    max_linear_m_per_s: float = setting(0.5, "maximum forward speed", minimum=0.05, changeable=True)
    careful_spread_m: float = setting(
        0.5, "standard deviation of the position above which the robot drives carefully", minimum=0.01
    )
    careful_m_per_s: float = setting(0.2, "maximum speed while the position is that uncertain", minimum=0.02)
    map_topic: str = setting("", "topic of the map to use, if the robot has several; '' for any")
    scan_topic: str = setting("", "topic of the laser that looks ahead, if there are several; '' for any")
    more_scan_topics: list[str] = setting(
        [], "topics of the other lasers; without fresh scans of all of them the robot does not back up"
    )
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
    stale_s: float = setting(0.4, "the robot stops when pose or laser is older than this", minimum=0.05)
    max_recoveries: int = setting(6, "recovery attempts before the goal is given up", minimum=0)
    enters_unknown: bool = setting(
        False, "drive through places that were never seen if no other path leads to the goal"
    )
    state_period_s: float = setting(0.5, "time between feedbacks while nothing changes", minimum=0.05)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Report scan topics that do not tell the lasers apart."""
        ahead, more = settings["scan_topic"], settings["more_scan_topics"]
        assert isinstance(more, list)
        if more and (not ahead or not all(more) or len({ahead, *more}) <= len(more)):
            text = "each laser needs a topic of its own: scan_topic and more_scan_topics"
            raise SettingError(text, "more_scan_topics")

    def setup(self) -> None:
        """Subscribe; the first scan creates the navigator."""
        self.navigator: Navigator | None = None
        self.hold = ""
        self.spread_m = 0.0
        self.laser_pose = np.zeros(3)
        self.mounts: dict[str, NDArray[np.float64]] = {}
        self.grid: OccupancyGrid | None = None
        self.no_go: list[NDArray[np.float64]] = []
        self.places: dict[str, tuple[float, float, float]] = {}
        self.active: Active | None = None
        self.goal: tuple[float, float, float] | None = None
        self.accepted_s = self.monotonic_s()
        self.fed_back: tuple[str, str] = ("", "")
        self.fed_back_s = -np.inf
        self.path = np.empty((0, 2))
        self.costs_of: NavigationGrid | None = None
        # An older state may hold a goal that was cancelled since; its client learns that it is lost.
        if self.restored is not None and not self.checkpoint_lost:
            self.active = self.resume_goal(NavigateTo, self.restored["goal"])
            x_m, y_m, heading_rad = self.restored["pose"]
            self.goal = (x_m, y_m, heading_rad)
            self.accepted_s = self.restored["accepted_s"]
        self.serve_goals(NavigateTo, self.on_goal, self.on_cancel)
        self.serve(CancelNavigation, self.on_cancel_navigation)
        self.serve(PlanPath, self.on_plan_path)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self.subscribe(MapAnnotations, self.on_annotations, newest, optional=True)
        self.subscribe(OccupancyGrid, self.on_map, newest, topic=self.map_topic)
        self.subscribe(MappingState, self.on_mapping_state, newest, topic=self.map_topic, optional=True)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose", deadline_s=self.stale_s)
        self.subscribe(LaserScan, self.on_scan, newest, topic=self.scan_topic, deadline_s=self.stale_s)
        for topic in self.more_scan_topics:
            self.subscribe(LaserScan, self.on_further_scan, newest, topic=topic, deadline_s=self.stale_s)
        self.subscribe(TFMessage, self.on_transforms, topic="tf_static", optional=True)
        self.subscribe(EmergencyStop, self.on_emergency_stop, newest, topic="emergency_stop_state")
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)

    def on_goal(self, active: Active) -> None:
        """Drive to a new goal from now on, unless it is invalid."""
        goal = self._pose_of(active.goal)
        self.log.info("goal: %.2f m, %.2f m, %.2f rad, from %s", *goal, active.client)
        before, self.active, self.goal = self.active, active, goal
        self.accepted_s = self.monotonic_s()
        # First of all: a goal that its client takes for preempted must not come back after a crash.
        self.checkpoint({"goal": active.memory, "accepted_s": self.accepted_s, "pose": list(goal)})
        if before is not None:
            before.preempt(f"{active.client} has sent another goal")
        if self.navigator is not None:
            self.navigator.go_to(goal)
        self.fed_back_s = -np.inf
        self.publish(pose_stamped(goal, Header(stamp=self.now(), frame_id="map")), topic="goal", latched=True)

    def _pose_of(self, goal: NavigateTo) -> tuple[float, float, float]:
        """Return where a goal is; refuse an invalid one."""
        if goal.place:
            if goal.place not in self.places:
                known = ", ".join(sorted(self.places)) or "none"
                raise CallRefused(f"no place on the map is called {goal.place!r:.80}; there are: {known}")
            return self.places[goal.place]
        frame = goal.pose.header.frame_id
        if frame not in MAP_FRAMES:
            raise CallRefused(f"a goal must be given in the frame 'map', not {frame!r}")
        return planar(goal.pose.pose)

    def on_cancel(self, active: Active, reason: str) -> None:
        """Stop, and end the goal."""
        if active is self.active:
            self._stop(reason)
            active.cancelled(reason)

    def on_cancel_navigation(self, request: CancelNavigation) -> NavigationCancelled:
        """Stop, and end the goal of any client."""
        active = self.active
        if active is None or request.client not in ("", active.client):
            return NavigationCancelled()
        self._stop(request.reason)
        active.cancelled(request.reason)
        return NavigationCancelled(client=active.client)

    def on_plan_path(self, request: PlanPath) -> PathPlanned:
        """Plan a path as for a goal, with the robot, its obstacles and no-go areas as they are now."""
        if self.navigator is None:
            raise CallRefused("no scan has arrived yet")
        goal = self._pose_of(NavigateTo(pose=request.pose))
        eye = request.seen_from[0] if request.seen_from else None
        try:
            way = self.navigator.way_to(goal, None if eye is None else (eye.x, eye.y))
        except NotReady as error:
            raise CallRefused(str(error)) from error
        if way.obstruction is not Obstruction.NONE:
            raise CallRefused(way.obstruction)
        return PathPlanned(path=self._message_of(way.path))

    def _stop(self, reason: str) -> None:
        """Forget the goal and stop the drive at once, without waiting for the last command to expire."""
        self._forget_goal()
        if self.navigator is not None:
            self.navigator.cancel(reason)
            self._command(0.0, 0.0)
            self._show()

    def _forget_goal(self) -> None:
        """Have no goal any more, even after a crash. Call this before its client hears of it."""
        had_goal = self.goal is not None
        self.active = self.goal = None
        self.checkpoint(None)
        if had_goal:
            self.publish(PoseStamped(header=Header(stamp=self.now())), topic="goal", latched=True)

    def on_time_jump(self, jump: TimeJump) -> None:
        """Forget the goal and all obstacles: they are no longer valid."""
        self.spread_m = 0.0
        active, self.navigator = self.active, None
        self._forget_goal()
        if active is not None:
            active.abort(f"time jumped: {jump.reason}")

    def on_map(self, grid: OccupancyGrid) -> None:
        """Plan on a new map."""
        self.grid = grid
        self._see_map()

    def on_annotations(self, annotations: MapAnnotations) -> None:
        """Stay out of the no-go areas from now on, and know the places."""
        areas = [one for one in annotations.no_go if len(one.corners) > 2]
        self.no_go = [np.array([(one.x, one.y) for one in area.corners]) for area in areas]
        self.places = {place.name: planar(place.pose) for place in annotations.places}
        self._see_map()

    def _see_map(self) -> None:
        """Pass map and no-go areas to the navigator."""
        if self.navigator is not None and self.grid is not None:
            cells, resolution_m, corner_xy_m = map_cells(self.grid)
            forbidden = forbid(cells, resolution_m, corner_xy_m, self.no_go)
            self.navigator.see_map(forbidden, resolution_m, corner_xy_m)

    def on_pose(self, pose: PoseStamped) -> None:
        """Pass the robot's pose to the navigator."""
        if self.navigator is not None:
            stamp_s = pose.header.stamp.nanoseconds / 1e9
            self.navigator.see_pose(planar(pose.pose), stamp_s, self._published_s())

    def on_mapping_state(self, state: MappingState) -> None:
        """Take how well mapping knows where the robot is."""
        self.spread_m = state.spread_m

    def on_transforms(self, message: TFMessage) -> None:
        """Take the lasers' mounting poses."""
        mounts = planar_mounts(message)
        self.mounts |= mounts
        mount = mounts.get(LASER)
        if mount is None or np.array_equal(mount, self.laser_pose):
            return
        self.laser_pose, self.navigator = mount, None

    def on_scan(self, scan: LaserScan) -> None:
        """Pass a scan to the navigator; the first one creates the navigator."""
        if self.navigator is None:
            self.navigator = self._make_navigator()
            self.navigator.see_hold(self.hold)
            self._see_map()
            if self.goal is not None:
                self.navigator.go_to(self.goal)
        stamp_s = scan.header.stamp.nanoseconds / 1e9
        self.navigator.see_sweep(sweep_of(scan), stamp_s, self._published_s())

    def on_further_scan(self, scan: LaserScan) -> None:
        """Pass a scan of another laser to the navigator, as soon as its mounting pose is known."""
        mount = self.mounts.get(scan.header.frame_id)
        if self.navigator is None or mount is None:
            return
        stamp_s = scan.header.stamp.nanoseconds / 1e9
        self.navigator.see_further_sweep(
            self.envelope.topic, mount, sweep_of(scan), stamp_s, self._published_s()
        )

    def on_emergency_stop(self, message: EmergencyStop) -> None:
        """Pass the emergency stop's state to the navigator."""
        if self.navigator is not None:
            self.navigator.see_emergency_stop((message.reason or "no reason given") * message.engaged)

    def on_control(self, control: ControlState) -> None:
        """Pass to the navigator whether the robot may drive by itself."""
        self.hold = "" if control.mode == ControlState.AUTO else control.reason or "no reason given"
        if self.navigator is not None:
            self.navigator.see_hold(self.hold)

    def setting_changed(self, name: str) -> None:
        """Apply a new maximum speed."""
        if self.navigator is not None:
            self.navigator.follower.settings = self._follower_settings()

    def tick(self) -> None:
        """Command the drive, and tell the goal's client how far the robot is."""
        if self.navigator is None:
            waits = self.active is not None
            self.show_state(NavigatorState.STOPPED_NO_LASER if waits else NavigatorState.IDLE)
            self._feed_back(NavigatorState.STOPPED_NO_LASER.name, "no scan has arrived yet", None)
            self.status = "waiting for the laser"
            return
        speeds = self.navigator.drive()
        if speeds is not None:
            self._command(*self._careful(*speeds))
        if self.navigator.path is not self.path:
            self._publish_path(self.navigator.path)
        if self.navigator.grid is not None and self.navigator.grid is not self.costs_of:
            self._publish_costmap(self.navigator.grid)
        self._show()
        state, reason = self.navigator.state, self.navigator.machine.reason
        if self.active is not None and state in RESTING:
            self._end(self.active, state, reason)
        else:
            self._feed_back(state.name, reason, self.navigator.distance_left_m)

    def _end(self, active: Active, state: NavigatorState, reason: str) -> None:
        """Tell the goal's client that the robot is there, or why it gives up."""
        self.log.info("%s: %s", state.name, reason)
        self._forget_goal()
        if state is NavigatorState.ARRIVED:
            active.succeed(NavigationResult(duration_s=self.monotonic_s() - self.accepted_s))
        else:
            active.abort(reason)

    def _feed_back(self, state: str, reason: str, left_m: float | None) -> None:
        """Tell the goal's client the state, if it is new or was told long ago."""
        if self.active is None:
            return
        is_old = self.monotonic_s() - self.fed_back_s >= self.state_period_s
        if self.fed_back != (state, reason) or is_old:
            self.fed_back, self.fed_back_s = (state, reason), self.monotonic_s()
            left = -1.0 if left_m is None else left_m
            self.active.feedback(NavigationFeedback(state=state, reason=reason, distance_left_m=left))

    def _show(self) -> None:
        """Show the navigator's state and status."""
        if self.navigator is not None:
            self.show_state(self.navigator.state)
            self.status = self.navigator.status
            if self.spread_m > self.careful_spread_m:
                self.status += f" (slowly: position ± {self.spread_m:.1f} m)"

    def _careful(self, linear_m_per_s: float, angular_rad_per_s: float) -> tuple[float, float]:
        """Return lower speeds, on the same arc, while the robot's position is uncertain."""
        if self.spread_m <= self.careful_spread_m or abs(linear_m_per_s) <= self.careful_m_per_s:
            return linear_m_per_s, angular_rad_per_s
        slower = self.careful_m_per_s / abs(linear_m_per_s)
        return slower * linear_m_per_s, slower * angular_rad_per_s

    def _command(self, linear_m_per_s: float, angular_rad_per_s: float) -> None:
        self.publish(
            DriveCommand(
                header=Header(stamp=self.now(), frame_id="base_link"),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=Duration.from_nanoseconds(round(self.command_valid_for_s * 1e9)),
                based_on=self._rests_on(),
            )
        )

    def _rests_on(self) -> Time:
        """Return the stamp of the oldest measurement that a command rests on."""
        rests_on_s = -math.inf if self.navigator is None else self.navigator.rests_on_s
        return Time() if math.isinf(rests_on_s) else Time.from_nanoseconds(round(rests_on_s * 1e9))

    def _make_navigator(self) -> Navigator:
        """Make the navigator for the laser's mounting pose."""
        settings = NavigatorSettings(
            clearance_m=self.clearance_m,
            tight_clearance_m=self.tight_clearance_m,
            tolerance_m=self.tolerance_m,
            heading_tolerance_rad=self.heading_tolerance_rad,
            stale_s=self.stale_s,
            max_recoveries=self.max_recoveries,
            enters_unknown=self.enters_unknown,
        )
        follower = PathFollower(self._follower_settings())
        return Navigator(
            self.monotonic_s,
            CollisionGuard(),
            follower,
            settings,
            self.laser_pose,
            further_lasers=self.more_scan_topics,
        )

    def _publish_path(self, path: NDArray[np.float64]) -> None:
        self.path = path
        self.publish(self._message_of(path), topic="path")

    def _message_of(self, path: NDArray[np.float64]) -> Path:
        header = Header(stamp=self.now(), frame_id="map")
        ahead = np.diff(path, axis=0, append=path[-1:])
        headings = np.arctan2(ahead[:, 1], ahead[:, 0])
        poses = [pose_stamped([*xy, heading], header) for xy, heading in zip(path, headings, strict=True)]
        return Path(header=header, poses=poses)

    def _publish_costmap(self, grid: NavigationGrid) -> None:
        self.costs_of = grid
        costs = cell_costs(grid)
        (height, width), (x_m, y_m) = costs.shape, grid.corner_xy_m.tolist()
        metadata = CostmapMetaData(
            update_time=self.now(),
            layer="master",
            resolution=grid.resolution_m,
            size_x=width,
            size_y=height,
            origin=Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion(w=1.0)),
        )
        header = Header(stamp=self.now(), frame_id="map")
        costmap = Costmap(header=header, metadata=metadata, data=costs.ravel())
        self.publish(costmap, topic="costmap", latched=True)

    def _follower_settings(self) -> FollowerSettings:
        return FollowerSettings(max_linear_m_per_s=self.max_linear_m_per_s)

    def _published_s(self) -> float:
        return self.envelope.published_ns / 1e9
