"""Nav2's behaviors: turn on the spot, drive straight on or back, and wait."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from robbie_mp import (
    ActiveGoal,
    CallError,
    CallRefused,
    Duration,
    Goal,
    Header,
    MessageHandling,
    Module,
    setting,
)
from robbie_mp.messages import (
    CancelNavigation,
    ControlState,
    DriveCommand,
    EmergencyStop,
    Odometry,
    PoseStamped,
    TimeJump,
)
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.modules.devices.command_age import AHEAD_S, MAX_AGE_S, age_of, check_order
from robbie_robots.modules.devices.hand_guard import HandGuard
from robbie_robots.modules.maps.planar_messages import planar
from robbie_robots.modules.navigation.nav2_types import (
    BackedUp,
    BackingUp,
    BackUp,
    DrivenOnHeading,
    DriveOnHeading,
    DrivingOnHeading,
    KiltedBackedUp,
    KiltedBackingUp,
    KiltedBackUp,
    KiltedDrivenOnHeading,
    KiltedDriveOnHeading,
    KiltedDrivingOnHeading,
    KiltedSpin,
    KiltedSpinning,
    KiltedSpun,
    Spin,
    Spinning,
    Spun,
    Wait,
    Waited,
    Waiting,
)

KINDS: dict[type[Goal[Any, Any]], tuple[Any, Any]] = {
    Spin: (Spinning, Spun),
    BackUp: (BackingUp, BackedUp),
    DriveOnHeading: (DrivingOnHeading, DrivenOnHeading),
    Wait: (Waiting, Waited),
    KiltedSpin: (KiltedSpinning, KiltedSpun),
    KiltedBackUp: (KiltedBackingUp, KiltedBackedUp),
    KiltedDriveOnHeading: (KiltedDrivingOnHeading, KiltedDrivenOnHeading),
}
SPINS, BACKS_UP = (Spin, KiltedSpin), (BackUp, KiltedBackUp)
FEEDBACK_S = 0.1
BLIND_S = 2.0
"""The goal is aborted when odometry or a laser that guards is older than this."""
JUMP = 0.1
"""Odometry may be wrong by this, m or rad, beyond twice the way at full speed while it is fresh."""
SLIP, SLIP_BEYOND = 2.0, 0.3
"""The goal is aborted when commands add up to SLIP times its way plus SLIP_BEYOND, m or rad."""
SLOWING_M_PER_S2, SLOWING_RAD_PER_S2 = 0.4, 0.8
SLOWEST_M_PER_S, SLOWEST_RAD_PER_S = 0.04, 0.1

Active = ActiveGoal[Any, Any, Any]


@dataclass
class _Motion:
    """What a goal asks for, and how far it is.

    Attributes:
        way: distance, m, or angle, rad; positive.
        speed: m/s or rad/s, with the sign of the direction; 0: wait for `way` seconds.
        is_turn: whether it is an angle.
        until_s: when its time is over.
        seen_s: when its way and its motion were last known.
        begun_ns: when it began, by the robot's time.
        done: how far the robot has moved in that direction.
        commanded: how far its commands would have moved it.
        is_free: whether navigation has stopped.
    """

    active: Active
    way: float
    speed: float
    is_turn: bool
    since_s: float
    until_s: float
    seen_s: float
    begun_ns: int
    done: float = 0.0
    commanded: float = 0.0
    is_free: bool = False
    fed_back_s: float = -math.inf

    @property
    def has_moved_enough(self) -> bool:
        return self.done >= self.way


class Nav2Behaviors(Module):
    """Serves Nav2's `Spin`, `BackUp`, `DriveOnHeading` and `Wait`, of Jazzy and of Kilted.

    Each moves the robot by odometry, with the guard that checks driving by hand: it stops before obstacles
    that the lasers see. Commands expire, so the robot stands if this module dies. A goal ends that of
    navigation, and a newer goal, of navigation too, takes its place. It is refused while modules may not
    drive the robot, and so is one that turns off the guard. It ends if odometry jumps, or does not show the
    motion that was commanded.
    """

    period_s: float = setting(0.05, "time between drive commands", minimum=0.01)
    command_valid_for_s: float = setting(
        0.3,
        "the drive stops if no newer command comes within this time",
        minimum=0.05,
        maximum=MAX_VALID_FOR_S,
    )
    guard_topics: list[str] = setting([""], "topics of the lasers that guard; '' for any")
    guard_radius_m: float = setting(0.2, "radius of the robot's body", minimum=0.05)
    max_age_s: float = MAX_AGE_S
    max_m_per_s: float = setting(0.3, "maximum speed", minimum=0.05)
    max_rad_per_s: float = setting(0.8, "maximum turn rate", minimum=0.1)
    max_back_m: float = setting(0.5, "longest way back: lasers may not look there", minimum=0.0)

    def setup(self) -> None:
        """Serve."""
        self.motion: _Motion | None = None
        self.control = ControlState()
        self.pose: tuple[float, float, float] | None = None
        self.moved_s = -math.inf
        self.navigates = False
        self.odometry = Odometry()
        self.guard = HandGuard(self, self.guard_topics, self.guard_radius_m, self.max_age_s)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(Odometry, self.on_odometry, topic="odom")
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)
        self.subscribe(EmergencyStop, self.on_stop, newest, topic="emergency_stop_state", optional=True)
        self.subscribe(PoseStamped, self.on_goal_of_navigation, topic="goal", optional=True)
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        for kind in KINDS:
            self.serve_goals(kind, self.on_goal, self.on_cancel)

    def on_goal(self, active: Active) -> None:
        """Begin a motion, once navigation has stopped."""
        motion = self._motion_of(active)
        if motion.speed and self.control.mode != ControlState.AUTO:
            reason = self.control.reason or "no reason given"
            raise CallRefused(f"modules may not drive the robot ({reason})")
        if motion.speed:
            check_order(self)
        before = self.motion
        if before is not None:
            self._end(before)
            before.active.preempt("another goal has come")
        self.motion = motion
        if not motion.speed:
            return

        def begin(_: object) -> None:
            motion.is_free = True

        def begin_without_navigation(error: CallError) -> None:
            # One that is stopped or starts again goes on with its goal later.
            if not self.navigates:
                begin(error)
            elif self.motion is motion:
                self._give_up(f"navigation has a goal, and does not end it: {error}")

        request = CancelNavigation(reason="a behavior of Nav2 moves the robot")
        self.call(request, begin, begin_without_navigation, timeout_s=1.0)

    def _motion_of(self, active: Active) -> _Motion:
        """Return what a goal asks for; refuse one that cannot be."""
        goal, now_s = active.goal, self.monotonic_s()
        new = partial(_Motion, active, since_s=now_s, seen_s=now_s, begun_ns=self.now().nanoseconds)
        if isinstance(goal, Wait):
            return new(seconds(goal.time), 0.0, False, until_s=math.inf)
        if getattr(goal, "disable_collision_checks", False):
            raise CallRefused("this robot does not drive without its collision checks")
        until_s = now_s + (seconds(goal.time_allowance) or math.inf)
        if isinstance(goal, SPINS):
            if not math.isfinite(goal.target_yaw):
                raise CallRefused("the angle is not a number")
            speed = math.copysign(self.max_rad_per_s, goal.target_yaw)
            return new(abs(goal.target_yaw), speed, True, until_s=until_s)
        way, speed = goal.target.x, goal.speed
        if isinstance(goal, BACKS_UP):
            way, speed = -abs(way), -abs(speed)
        is_number = math.isfinite(way) and math.isfinite(speed)
        if goal.target.y or goal.target.z or not is_number or not speed or way * speed < 0.0:
            raise CallRefused("the target must be along x, and the speed in the same direction")
        if -way > self.max_back_m:
            raise CallRefused(f"this robot drives back {self.max_back_m:g} m at most, not {-way:g} m")
        speed = math.copysign(min(abs(speed), self.max_m_per_s), speed)
        return new(abs(way), speed, False, until_s=until_s)

    def on_cancel(self, active: Active, reason: str) -> None:
        """Stand, and end the goal."""
        if self.motion is not None and self.motion.active is active:
            self._end(self.motion)
            active.cancelled(reason)

    def on_control(self, control: ControlState) -> None:
        """Give up when modules may no longer drive."""
        self.control = control
        if control.mode != ControlState.AUTO:
            self._give_up(f"modules may not drive the robot ({control.reason or 'no reason given'})")

    def on_stop(self, stop: EmergencyStop) -> None:
        """Give up when the emergency stop is engaged."""
        if stop.engaged:
            self._give_up(f"the emergency stop is engaged: {stop.reason}")

    def on_time_jump(self, jump: TimeJump) -> None:
        """Give up: odometry is that of another time."""
        self._give_up(f"time jumped: {jump.reason}")
        self.pose = None

    def on_goal_of_navigation(self, goal: PoseStamped) -> None:
        """Give way to a goal that navigation has got after this one."""
        motion, self.navigates = self.motion, bool(goal.header.frame_id)
        if motion is None or not motion.speed or not self.navigates:
            return
        if goal.header.stamp.nanoseconds >= motion.begun_ns:
            self._end(motion)
            motion.active.preempt("navigation has got a goal")

    def on_odometry(self, odometry: Odometry) -> None:
        """Add up how far the robot has moved."""
        x_m, y_m, heading_rad = planar(odometry.pose.pose)
        before, self.pose = self.pose, (x_m, y_m, heading_rad)
        self.moved_s, self.odometry = self.monotonic_s(), odometry
        motion = self.motion
        if before is None or motion is None or not motion.is_free:
            return
        turned_rad = math.remainder(heading_rad - before[2], math.tau)
        if not self._is_plausible(math.hypot(x_m - before[0], y_m - before[1]), turned_rad):
            self._give_up("odometry has jumped")  # as that of a base that starts again
            return
        along_m = (x_m - before[0]) * math.cos(before[2]) + (y_m - before[1]) * math.sin(before[2])
        motion.done += math.copysign(1.0, motion.speed) * (turned_rad if motion.is_turn else along_m)

    def _is_plausible(self, moved_m: float, turned_rad: float) -> bool:
        """Whether the robot can have moved so far between two messages of odometry."""
        fresh_s = 2 * self.max_age_s
        can_move = moved_m <= JUMP + self.max_m_per_s * fresh_s
        return can_move and abs(turned_rad) <= JUMP + self.max_rad_per_s * fresh_s

    def tick(self) -> None:
        """Move on, or end."""
        motion, now_s = self.motion, self.monotonic_s()
        if motion is None:
            self.status = "no goal"
            return
        self.status = type(motion.active.goal).__name__
        if not motion.speed:
            motion.done = now_s - motion.since_s
        if motion.has_moved_enough:
            self._end(motion)
            _, result = KINDS[type(motion.active.goal)]
            motion.active.succeed(result(total_elapsed_time=duration(now_s - motion.since_s)))
            return
        if now_s >= motion.until_s:
            self._give_up("TIMEOUT: the time that the goal allows is over")
            return
        if motion.is_free:
            self._drive(motion, now_s)
        if self.motion is motion and now_s - motion.fed_back_s >= FEEDBACK_S:
            motion.fed_back_s = now_s
            self._feed_back(motion)

    def _drive(self, motion: _Motion, now_s: float) -> None:
        """Command the next speed, or give up."""
        if now_s - motion.seen_s > BLIND_S:
            late = "a laser that guards the robot, or its odometry, has sent nothing lately"
            self._give_up(f"{late}, or this module was stopped")
            return
        if self.guard.sees_for_s <= 0.0 or not self._knows_motion(now_s):
            return
        motion.seen_s = now_s
        linear, angular = self._wanted(motion)
        checked, _ = self.guard.checked(linear, angular)
        if linear and not checked:
            self._give_up("COLLISION_AHEAD: an obstacle is in the way")
            return
        if motion.commanded > SLIP * motion.way + SLIP_BEYOND:
            told = f"{motion.done:.2f} of {motion.commanded:.2f} {'rad' if motion.is_turn else 'm'}"
            self._give_up(f"odometry shows {told} that were commanded")
            return
        motion.commanded += self.period_s * abs(checked or angular)
        self._command(checked, angular)

    def _knows_motion(self, now_s: float) -> bool:
        """Whether odometry is fresh, by its stamp too: the base looks at that, and would not follow."""
        age_s = age_of(self, self.odometry.header.stamp)
        return age_s >= -AHEAD_S and max(age_s, now_s - self.moved_s) <= self.max_age_s

    def _wanted(self, motion: _Motion) -> tuple[float, float]:
        """Return forward speed and turn rate, lower towards the end."""
        left = motion.way - motion.done
        slowing = SLOWING_RAD_PER_S2 if motion.is_turn else SLOWING_M_PER_S2
        slowest = SLOWEST_RAD_PER_S if motion.is_turn else SLOWEST_M_PER_S
        speed = min(abs(motion.speed), max(slowest, math.sqrt(2 * slowing * left)))
        speed = math.copysign(speed, motion.speed)
        return (0.0, speed) if motion.is_turn else (speed, 0.0)

    def _command(self, linear_m_per_s: float, angular_rad_per_s: float) -> None:
        self.publish(
            DriveCommand(
                header=Header(stamp=self.now(), frame_id="base_link"),
                linear_m_per_s=linear_m_per_s,
                angular_rad_per_s=angular_rad_per_s,
                valid_for=duration(min(self.command_valid_for_s, max(0.01, self.guard.sees_for_s))),
                based_on=self.odometry.header.stamp,
            )
        )

    def _feed_back(self, motion: _Motion) -> None:
        feedback, _ = KINDS[type(motion.active.goal)]
        if not motion.speed:
            motion.active.feedback(feedback(time_left=duration(motion.way - motion.done)))
        elif motion.is_turn:
            motion.active.feedback(feedback(angular_distance_traveled=motion.done))
        else:
            motion.active.feedback(feedback(distance_traveled=motion.done))

    def _give_up(self, reason: str) -> None:
        motion = self.motion
        if motion is not None and motion.speed:
            self._end(motion)
            motion.active.abort(reason)

    def _end(self, motion: _Motion) -> None:
        """Forget a motion, and stand; the last command would also expire."""
        self.motion = None
        if motion.speed and motion.is_free:
            self._command(0.0, 0.0)


def seconds(time: Duration) -> float:
    """Return a duration in s, at least 0."""
    return max(0.0, time.nanoseconds / 1e9)


def duration(time_s: float) -> Duration:
    """Return a duration of at least 0."""
    return Duration.from_nanoseconds(max(0, round(time_s * 1e9)))
