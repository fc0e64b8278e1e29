"""Nav2's actions, with which RViz's Nav2 panel and `ros2 action send_goal` drive the robot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from math import hypot
from typing import Any

from robbie_mp import (
    ActiveGoal,
    CallError,
    CallRefused,
    Duration,
    GoalAborted,
    GoalCancelled,
    GoalPreempted,
    MessageHandling,
    Module,
    Reply,
    Request,
    SentGoal,
    setting,
)
from robbie_mp.messages import (
    CancelNavigation,
    ControlState,
    NavigateTo,
    NavigationFeedback,
    NavigationResult,
    PoseStamped,
    TimeJump,
)
from robbie_mp.messages.stock.nav2_msgs import (
    FollowedWaypoints,
    FollowingWaypoints,
    FollowWaypoints,
    MissedWaypoint,
    NavigatedThroughPoses,
    NavigatedToPose,
    NavigateThroughPoses,
    NavigateToPose,
    NavigatingThroughPoses,
    NavigatingToPose,
)
from robbie_robots.modules.navigation.nav2_types import (
    KiltedFollowedWaypoints,
    KiltedFollowingWaypoints,
    KiltedFollowWaypoints,
    KiltedNavigatedThroughPoses,
    KiltedNavigateThroughPoses,
    KiltedNavigatingThroughPoses,
    WaypointStatus,
)
from robbie_robots.workers.navigation.navigator_states import RECOVERIES

THROUGH_POSES = (NavigateThroughPoses, KiltedNavigateThroughPoses)
RECOVERY_NAMES = frozenset(one.name for one in RECOVERIES)
TASK_EXECUTOR_FAILED = 601
"""Nav2's number for a waypoint that was not reached."""
END_EVERY_S = 0.5
MAX_LEFT_S = 86400.0
MAX_RECOVERIES = MAX_POSES = 32767
MAX_MISSED = 1000

ToPose = ActiveGoal[NavigateToPose, NavigatingToPose, NavigatedToPose]
ThroughPoses = ActiveGoal[NavigateThroughPoses, NavigatingThroughPoses, NavigatedThroughPoses]
KiltedThroughPoses = ActiveGoal[
    KiltedNavigateThroughPoses, KiltedNavigatingThroughPoses, KiltedNavigatedThroughPoses
]
Waypoints = ActiveGoal[FollowWaypoints, FollowingWaypoints, FollowedWaypoints]
KiltedWaypoints = ActiveGoal[KiltedFollowWaypoints, KiltedFollowingWaypoints, KiltedFollowedWaypoints]


class NavigationActive(Reply, name="robbie_msgs/srv/IsNavigationActive_Response"):
    """Navigation takes goals."""


class IsNavigationActive(Request[NavigationActive], name="robbie_msgs/srv/IsNavigationActive_Request"):
    """Ask as Nav2's panel in RViz does before it sends goals."""


@dataclass(eq=False)
class _Drive:
    """What is remembered of a goal, of any action."""

    active: ActiveGoal[Any, Any, Any]
    since_s: float
    sent: SentGoal | None = None
    state: str = ""
    recoveries: int = 0
    first_left_m: float | None = None
    index: int = 0
    """Index of the pose among several; `loops_left` and `missed` are of waypoints."""
    loops_left: int = 0
    missed: list[tuple[int, PoseStamped, str]] = field(default_factory=list)
    """Index and pose of each waypoint that was not reached, and the reason."""


class Nav2Actions(Module):
    """Serves Nav2's actions by goals for the module that serves `NavigateTo`.

    So they obey who controls the robot, as every goal does, and the newest goal takes the place of the older
    one. A goal is refused while modules may not drive the robot. Otherwise it would move the robot as soon as
    an operator orders the robot to go on, who may not know of it. If this module dies, its goals end, and the
    robot stops.
    """

    stops_on_missed: bool = setting(
        True, "give up at the first waypoint that was not reached, as Nav2 does; otherwise drive to the next"
    )

    def setup(self) -> None:
        """Serve."""
        self.pose = PoseStamped()
        self.control = ControlState()
        self.drives: dict[ActiveGoal[Any, Any, Any], _Drive] = {}
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose", optional=True)
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        self.serve_goals(NavigateToPose, self.on_pose_goal, self.on_cancel)
        self.serve_goals(NavigateThroughPoses, self.on_through_poses, self.on_cancel)
        self.serve_goals(FollowWaypoints, self.on_waypoints, self.on_cancel)
        self.serve_goals(KiltedNavigateThroughPoses, self.on_through_poses, self.on_cancel)
        self.serve_goals(KiltedFollowWaypoints, self.on_waypoints, self.on_cancel)
        self.serve(IsNavigationActive, self.on_question)
        if self.restored is not None:
            self.ending = self.every(END_EVERY_S, self.end_earlier_goals)

    def end_earlier_goals(self) -> None:
        """End what an earlier process has begun, until navigation has heard it."""
        request = CancelNavigation(client=self.name, reason="the module of Nav2's actions has died")
        self.call(request, lambda _: self.ending.stop(), lambda _: None, timeout_s=END_EVERY_S)

    def on_question(self, _: IsNavigationActive) -> NavigationActive:
        """Say that goals are welcome."""
        return NavigationActive()

    def on_pose(self, pose: PoseStamped) -> None:
        """Keep where the robot is, for the feedback."""
        self.pose = pose

    def on_control(self, control: ControlState) -> None:
        """Keep whether modules may drive the robot."""
        self.control = control

    def on_time_jump(self, jump: TimeJump) -> None:
        """End all goals, as navigation does: the next waypoint would drive the robot in another time."""
        reason = f"time jumped: {jump.reason}"
        for drive in list(self.drives.values()):
            if drive.sent is not None:
                drive.sent.cancel(reason)
            self._end(drive, GoalAborted(reason))

    def on_pose_goal(self, active: ToPose) -> None:
        """Drive to a pose."""
        drive = self._begin(active)

        def on_feedback(feedback: NavigationFeedback) -> None:
            active.feedback(NavigatingToPose(**self._progress(drive, feedback)))

        def on_result(_: NavigationResult) -> None:
            self._forget(drive)
            active.succeed(NavigatedToPose())

        self._drive_to(drive, active.goal.pose, on_result, lambda error: self._end(drive, error), on_feedback)

    def on_through_poses(self, active: ThroughPoses | KiltedThroughPoses) -> None:
        """Drive to the first pose."""
        poses = poses_of(active.goal)
        if not 0 < len(poses) <= MAX_POSES:
            raise CallRefused(f"the goal has {len(poses)} poses, not 1 to {MAX_POSES}")
        self._drive_to_next(self._begin(active))

    def on_waypoints(self, active: Waypoints | KiltedWaypoints) -> None:
        """Drive to the first waypoint."""
        goal = active.goal
        if goal.goal_index >= len(goal.poses):
            raise CallRefused(f"there is no waypoint {goal.goal_index}: the goal has {len(goal.poses)}")
        drive = self._begin(active)
        drive.index, drive.loops_left = goal.goal_index, goal.number_of_loops
        self._drive_to_next(drive)

    def on_cancel(self, active: ActiveGoal[Any, Any, Any], reason: str) -> None:
        """Let navigation end the goal; its client hears of it when the robot was told to stop."""
        drive = self.drives.get(active)
        if drive is not None and not (drive.sent is not None and drive.sent.cancel(reason)):
            self._forget(drive)
            active.cancelled(reason)

    def _begin(self, active: ActiveGoal[Any, Any, Any]) -> _Drive:
        if self.control.mode != ControlState.AUTO:
            reason = self.control.reason or "no reason given"
            raise CallRefused(
                f"modules may not drive the robot ({reason}); order it to go on, then send this again"
            )
        drive = self.drives[active] = _Drive(active, self.monotonic_s())
        self.checkpoint(True)
        return drive

    def _forget(self, drive: _Drive) -> None:
        self.drives.pop(drive.active, None)
        if not self.drives:
            self.checkpoint(None)

    def _end(self, drive: _Drive, error: CallError) -> None:
        """End a goal that navigation has not reached."""
        self._forget(drive)
        active, reason = drive.active, str(error)
        if not active.is_active:
            return
        if isinstance(error, GoalCancelled):
            active.cancelled(reason)
        elif isinstance(error, GoalPreempted):
            active.preempt(reason)
        else:
            active.abort(reason)

    def _drive_to(
        self,
        drive: _Drive,
        pose: PoseStamped,
        on_result: Callable[[NavigationResult], None],
        on_error: Callable[[CallError], None],
        on_feedback: Callable[[NavigationFeedback], None] | None = None,
    ) -> None:
        drive.sent = self.send_goal(NavigateTo(pose=pose), on_result, on_error, on_feedback)

    def _progress(self, drive: _Drive, feedback: NavigationFeedback, beyond_m: float = 0.0) -> dict[str, Any]:
        """Return how far the robot is, as fields of the feedback of both actions.

        Args:
            drive: the goal.
            feedback: of navigation, on the way to the next pose.
            beyond_m: length of the way beyond that pose.
        """
        if feedback.state != drive.state:
            drive.state = feedback.state
            drive.recoveries += feedback.state in RECOVERY_NAMES
        driven_s, left_m = self.monotonic_s() - drive.since_s, max(0.0, feedback.distance_left_m) + beyond_m
        if drive.first_left_m is None and feedback.distance_left_m >= 0.0:
            drive.first_left_m = left_m
        nearer_m = (drive.first_left_m or 0.0) - left_m
        left_s = min(MAX_LEFT_S, left_m * driven_s / nearer_m) if nearer_m > 0.0 else 0.0
        return {
            "current_pose": self.pose,
            "navigation_time": Duration.from_nanoseconds(round(driven_s * 1e9)),
            "estimated_time_remaining": Duration.from_nanoseconds(round(left_s * 1e9)),
            "number_of_recoveries": min(drive.recoveries, MAX_RECOVERIES),
            "distance_remaining": left_m,
        }

    def _drive_to_next(self, drive: _Drive) -> None:
        """Drive to the next waypoint, or the next pose of several."""
        goal = drive.active.goal
        pose, is_through = poses_of(goal)[drive.index], isinstance(goal, THROUGH_POSES)
        if isinstance(goal, FollowWaypoints):
            drive.active.feedback(FollowingWaypoints(current_waypoint=drive.index))
        elif not is_through:
            drive.active.feedback(KiltedFollowingWaypoints(current_waypoint=drive.index))

        def on_error(error: CallError) -> None:
            is_missed = not is_through and isinstance(error, GoalAborted | CallRefused)
            if self.stops_on_missed or not is_missed or not drive.active.is_active:
                self._end(drive, error)
                return
            self.log.warning("waypoint %d was not reached: %s", drive.index, error)
            drive.missed = [*drive.missed, (drive.index, pose, str(error))][:MAX_MISSED]
            self._go_on(drive)

        on_feedback = partial(self._tell_through, drive) if is_through else None
        self._drive_to(drive, pose, lambda _: self._go_on(drive), on_error, on_feedback)

    def _tell_through(self, drive: _Drive, feedback: NavigationFeedback) -> None:
        """Report the distance left: along the path to the next pose, and in straight lines after it."""
        poses = poses_of(drive.active.goal)
        legs = poses[drive.index :]
        beyond_m = sum(distance_m(one, other) for one, other in pairwise(legs))
        progress = self._progress(drive, feedback, beyond_m) | {"number_of_poses_remaining": len(legs)}
        if isinstance(drive.active.goal, NavigateThroughPoses):
            drive.active.feedback(NavigatingThroughPoses(**progress))
        else:
            statuses = waypoint_statuses(poses, drive.index)
            drive.active.feedback(KiltedNavigatingThroughPoses(**progress, waypoint_statuses=statuses))

    def _go_on(self, drive: _Drive) -> None:
        """Drive to the next waypoint or pose, if there is one."""
        if not drive.active.is_active:
            return
        drive.index += 1
        poses = poses_of(drive.active.goal)
        if drive.index == len(poses) and drive.loops_left:
            drive.index, drive.loops_left = 0, drive.loops_left - 1
        if drive.index < len(poses):
            self._drive_to_next(drive)
            return
        self._forget(drive)
        drive.active.succeed(_result(drive, poses))


def poses_of(goal: Any) -> list[PoseStamped]:
    """Return the poses of a goal with several, of any distribution of ROS."""
    poses: list[PoseStamped] = (
        goal.poses.goals if isinstance(goal, KiltedNavigateThroughPoses) else goal.poses
    )
    return poses


def waypoint_statuses(poses: Sequence[PoseStamped], done: int) -> list[WaypointStatus]:
    """Return what became of poses to drive through.

    Args:
        poses: the poses.
        done: how many of them the robot has been at.
    """
    told = (WaypointStatus.PENDING, WaypointStatus.COMPLETED)
    return [
        WaypointStatus(waypoint_status=told[index < done], waypoint_index=index, waypoint_pose=pose)
        for index, pose in enumerate(poses)
    ]


def _result(drive: _Drive, poses: Sequence[PoseStamped]) -> Any:
    """Return the result of a goal with several poses that has succeeded."""
    match drive.active.goal:
        case NavigateThroughPoses():
            return NavigatedThroughPoses()
        case KiltedNavigateThroughPoses():
            return KiltedNavigatedThroughPoses(waypoint_statuses=waypoint_statuses(poses, len(poses)))
        case FollowWaypoints():
            missed = [
                MissedWaypoint(index=index, goal=pose, error_code=TASK_EXECUTOR_FAILED)
                for index, pose, _ in drive.missed
            ]
            return FollowedWaypoints(missed_waypoints=missed)
    return KiltedFollowedWaypoints(
        missed_waypoints=[
            WaypointStatus(
                waypoint_status=WaypointStatus.FAILED,
                waypoint_index=index,
                waypoint_pose=pose,
                error_code=TASK_EXECUTOR_FAILED,
                error_msg=reason,
            )
            for index, pose, reason in drive.missed
        ]
    )


def distance_m(one: PoseStamped, other: PoseStamped) -> float:
    """Return the distance of two poses in the plane."""
    a, b = one.pose.position, other.pose.position
    return hypot(b.x - a.x, b.y - a.y)
