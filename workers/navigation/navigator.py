"""Drives to goals: computes the drive's speeds from map, poses and sweeps, with a state machine.

The navigator plans on the map and the obstacles that the laser sees, drives around obstacles, runs recoveries
when it makes no progress, and gives up a goal with a reason.
"""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep, UnusableSweeps
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.costmap import LiveCostmap
from robbie_robots.workers.navigation.live_obstacles import LiveObstacles
from robbie_robots.workers.navigation.local_planner import LocalPlanner
from robbie_robots.workers.navigation.navigator_states import (
    RECOVERIES,
    RESTING,
    STOPPED,
    TRANSITIONS,
    NavigatorSettings,
    NavigatorState,
)
from robbie_robots.workers.navigation.path_follower import HALT, PathFollower, Velocity
from robbie_robots.workers.navigation.progress_watch import ProgressWatch
from robbie_robots.workers.navigation.way_planner import Obstruction, Way, plan_way
from robbie_robots.workers.odometry_track import OdometryTrack
from robbie_robots.workers.planar_pose import compose, transform_points, wrap_angle

BACK_UP_M_PER_S = 0.15
ROTATE_RAD_PER_S = 0.8
ALIGN_PER_S, LEAST_ALIGN_RAD_PER_S, MOST_ALIGN_RAD_PER_S = 2.0, 0.2, 1.0
TRACKED = 400  # poses kept to interpolate a sweep's pose
PROGRESS_M = 0.5
FORESEEN_S = 0.4  # a command that would bring the robot into a no-go area within this time is not given
# A path may lead through what was never seen, or is not there any more, as a door in which the robot stands.
PASSABLE = (Obstruction.UNKNOWN_GOAL, Obstruction.NO_WAY, Obstruction.ROBOT)
DETOUR_M = 1.0  # a path that is longer than the previous one by this much counts as a detour


class NotReady(RuntimeError):
    """The navigator does not know enough to plan."""


class _Seen(NamedTuple):
    """What a laser has seen last, when the sweep was published, in the clock's time, and its stamp."""

    mounted: MountedSweep
    told_s: float
    stamp_s: float


class _Situation(NamedTuple):
    """The inputs that the robot needs to drive to a goal. All are known."""

    costmap: LiveCostmap
    pose: NDArray[np.float64]
    points: NDArray[np.float64]  # near the robot, of all lasers, as the guard expects them
    loose: NDArray[np.bool_]  # which of them may move: the map shows free ground there
    goal: NDArray[np.float64]


class Navigator:
    """Drives to successive goals. Call `drive` at 10 to 20 Hz.

    Args:
        clock: Returns the time in s; the stamps of all inputs are in this time.
        guard: Checks every command against the newest sweeps.
        follower: Steers along the planned ways.
        settings: Settings of the navigator.
        laser_pose: The laser's mounting pose on the robot (x m, y m, heading rad).
        further_lasers: Names of the lasers beside the one that looks ahead. The robot backs up only while it
            has a fresh sweep of each. Without one it drives on; an old sweep is not used.

    Attributes:
        machine: The state, and the reason for the last transition.
        follower: Steers along the planned ways.
        goal: (x m, y m, heading rad), map frame; None before the first.
        recoveries: Number of recoveries since the last progress.
        grid: The map with live obstacles on which it has planned last; None before the first plan.
        unusable: Counts the sweeps that were not taken.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        guard: CollisionGuard,
        follower: PathFollower | None = None,
        settings: NavigatorSettings | None = None,
        laser_pose: ArrayLike = (0.0, 0.0, 0.0),
        further_lasers: Iterable[str] = (),
    ) -> None:
        self.settings = settings or NavigatorSettings()
        self.machine = StateMachine(NavigatorState.IDLE, TRANSITIONS, clock, self.settings.time_outs())
        self.goal: NDArray[np.float64] | None = None
        self.recoveries = 0
        self.grid: NavigationGrid | None = None
        self.laser_pose = np.asarray(laser_pose, float)
        self._clock = clock
        self.follower = follower or PathFollower()
        self._guard = guard
        self._local = LocalPlanner(guard, self.follower)
        self._obstacles = LiveObstacles()
        self._progress = ProgressWatch()
        self._costmap: LiveCostmap | None = None
        self._pose: tuple[NDArray[np.float64], float] | None = None
        self._sweep: _Seen | None = None
        self.unusable = UnusableSweeps()
        self._stamps_s = [-math.inf, -math.inf]  # of the newest pose and sweep
        self._track = OdometryTrack(TRACKED)
        self._waiting: dict[str, tuple[NDArray[np.float64], LaserSweep, float]] = {}
        self._further: dict[str, _Seen | None] = dict.fromkeys(further_lasers)
        self._emergency = self._hold = ""
        self._renew()

    @property
    def state(self) -> NavigatorState:
        """Return the current state."""
        return self.machine.state

    @property
    def path(self) -> NDArray[np.float64]:
        """Return the planned path `(N, 2)`, m, map frame; empty if there is none."""
        return self.follower.path

    @property
    def distance_left_m(self) -> float | None:
        """Return the remaining length of the planned path; None if there is none."""
        if self._pose is None or not len(self.path):
            return None
        return self.follower.way_left_m(self._pose[0])

    @property
    def status(self) -> str:
        """Return state and reason in one line."""
        left = self.distance_left_m
        way = "" if left is None or self.state in RESTING else f"; {left:.1f} m left"
        around = ", around an obstacle" if self.state is NavigatorState.DRIVE and self._local.avoiding else ""
        without = "".join(f"; no fresh scan of {name}: the robot does not back up" for name in self.silent)
        return (
            f"{self.state}{around} ({self.machine.reason}){way}; {len(self._obstacles)} live obstacle cells"
            f"{without}{self.unusable}"
        )

    @property
    def silent(self) -> list[str]:
        """Return the names of the further lasers that have sent no sweep lately."""
        return [name for name, laser in self._further.items() if not self._is_fresh(laser)]

    def go_to(self, goal: ArrayLike) -> None:
        """Drive to (x m, y m, heading rad), map frame; replaces the old goal."""
        self.goal = np.asarray(goal, float)
        self._renew()
        self.machine.go(NavigatorState.DRIVE, "a new goal")

    def way_to(self, goal: ArrayLike, seen_from: ArrayLike | None = None) -> Way:
        """Plan a path to (x m, y m, heading rad), map frame, without driving it.

        Args:
            goal: Where the path leads.
            seen_from: (x m, y m) from where somebody sees the goal; None: nobody needs to.

        Raises:
            NotReady: Laser, pose or map is missing.
        """
        if (missing := self._what_is_missing()) is not None:
            raise NotReady(self._why(missing))
        situation = self._situation_of(np.asarray(goal, float))
        grid = situation.costmap.grid(self._obstacles, self._clock())
        if seen_from is not None and grid.hides(situation.goal, seen_from):
            return Way(Obstruction.HIDDEN_GOAL)
        return self._find(situation, grid)

    def cancel(self, reason: str) -> None:
        """Forget the goal."""
        self.goal = None
        self._end(NavigatorState.IDLE, reason)

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        """Take a new map, or new no-go areas on it: see `LiveCostmap` for the arguments."""
        self._costmap = LiveCostmap(cells, resolution_m, corner_xy_m, self.settings.clearance_m)

    def see_pose(self, pose: ArrayLike, stamp_s: float, told_s: float) -> None:
        """Take the robot's pose.

        Args:
            pose: (x, y, heading), m and rad, map frame.
            stamp_s: When the robot was there, in the time of the sweeps' stamps.
            told_s: When the pose was published, in the clock's time.
        """
        self._pose = np.asarray(pose, float), told_s
        self._stamps_s[0] = stamp_s
        self._track.add(stamp_s, pose)
        self._place_sweep()

    def see_sweep(self, sweep: LaserSweep, stamp_s: float, told_s: float) -> None:
        """Take a sweep, unless it is unusable, which counts as no sweep.

        Args:
            sweep: The sweep.
            stamp_s: When it was taken, in the time of the poses' stamps.
            told_s: When the sweep was published, in the clock's time.
        """
        if self.unusable.passes(sweep):
            self._sweep = _Seen(MountedSweep(sweep, self.laser_pose), told_s, stamp_s)
            self._stamps_s[1] = stamp_s
            self._waiting[""] = self.laser_pose, sweep, stamp_s
            self._place_sweep()

    def see_further_sweep(
        self, name: str, laser_pose: ArrayLike, sweep: LaserSweep, stamp_s: float, told_s: float
    ) -> None:
        """Take a sweep of a further laser, unless it is unusable.

        Args:
            name: Which one, of `further_lasers`.
            laser_pose: Its mounting pose on the robot (x m, y m, heading rad).
            sweep: The sweep.
            stamp_s: When it was taken, in the time of the poses' stamps.
            told_s: When the sweep was published, in the clock's time.
        """
        if self.unusable.passes(sweep):
            mount = np.asarray(laser_pose, float)
            self._further[name] = _Seen(MountedSweep(sweep, mount), told_s, stamp_s)
            self._waiting[name] = mount, sweep, stamp_s
            self._place_sweep()

    def _place_sweep(self) -> None:
        """Add the newest sweeps to the obstacles once the robot's pose at their stamps is known."""
        for name, (mount, sweep, stamp_s) in list(self._waiting.items()):
            place = self._track.at(stamp_s)
            if place is not None:
                self._obstacles.see(compose(place.pose, mount), sweep, self._clock(), name)
                del self._waiting[name]

    def see_emergency_stop(self, reason: str) -> None:
        """Take the reason of the emergency stop; '' if there is none."""
        self._emergency = reason

    def see_hold(self, reason: str) -> None:
        """Take the reason why the robot must stand until somebody orders it to go on; '' if it may drive."""
        self._hold = reason

    @property
    def rests_on_s(self) -> float:
        """Return the stamp of the oldest input on which the speeds of `drive` rest, s; -inf before the first.

        The map is not among them: what has come into the robot's way since is in the sweep. Further lasers
        are while the robot backs up, which it does only by what they see.
        """
        backs_up = self.state is NavigatorState.BACK_UP
        further = [one.stamp_s for one in self._further.values() if one is not None and backs_up]
        return min(*self._stamps_s, *further)

    def drive(self) -> Velocity | None:
        """Return forward speed (m/s) and turn rate (rad/s); None if there is no goal to drive to."""
        if self.state in RESTING:
            return None
        stopped = self._what_stops()
        if stopped is not None:
            if self.state is not stopped:
                self.machine.go(stopped, self._why(stopped))
            return HALT
        if self.state in STOPPED:
            self._renew()
            self.machine.go(NavigatorState.DRIVE, "map, pose and laser are available again")
        elif self.machine.expire():
            self._planned_s, self._moved_s = -math.inf, self._clock()
        return HALT if self.state in RESTING else self._act(self._situation())

    def _situation(self) -> _Situation:
        """Return the inputs for driving. Call it only if nothing stops the robot and it has a goal."""
        assert self.goal is not None
        return self._situation_of(self.goal)

    def _situation_of(self, goal: NDArray[np.float64]) -> _Situation:
        """Return the inputs for a goal. Call it only if none is missing."""
        assert self._costmap is not None
        assert self._pose is not None
        seen = [self._sweep, *filter(self._is_fresh, self._further.values())]
        pose, points = self._pose[0], self._guard.near_points(one.mounted for one in seen if one is not None)
        loose = self._costmap.shows_free(transform_points(pose, points))
        return _Situation(self._costmap, pose, points, loose, goal)

    def _is_fresh(self, laser: _Seen | None) -> bool:
        return laser is not None and self._clock() - laser.told_s <= self.settings.stale_s

    def _act(self, situation: _Situation) -> Velocity:
        match self.state:
            case NavigatorState.CLEAR_COSTMAP:
                return HALT
            case NavigatorState.BACK_UP:
                if self.silent:
                    return HALT
                back = self._guard.checked(situation.points, (-BACK_UP_M_PER_S, 0.0), situation.loose)
                return self._kept_out(situation, back)
            case NavigatorState.ROTATE:
                return 0.0, ROTATE_RAD_PER_S
            case NavigatorState.ALIGN:
                return self._aligned(situation)
        if self._clock() - self._planned_s >= self.settings.plan_period_s:
            self._plan(situation)
        return self._along_path(situation) if self.state is NavigatorState.DRIVE else HALT

    def _what_stops(self) -> NavigatorState | None:
        """Return the state in which the robot must stop; None if it may drive."""
        if self._emergency:
            return NavigatorState.EMERGENCY_STOP
        if self._hold:
            return NavigatorState.STOPPED_HOLD
        return self._what_is_missing()

    def _what_is_missing(self) -> NavigatorState | None:
        """Return the state of a robot that does not know enough to drive; None if it knows all."""
        if self._is_old(self._sweep):
            return NavigatorState.STOPPED_NO_LASER
        if self._is_old(self._pose):
            return NavigatorState.STOPPED_NO_POSE
        return NavigatorState.STOPPED_NO_MAP if self._costmap is None else None

    def _why(self, stopped: NavigatorState) -> str:
        if stopped is NavigatorState.EMERGENCY_STOP:
            return self._emergency
        if stopped is NavigatorState.STOPPED_HOLD:
            return self._hold
        if stopped is NavigatorState.STOPPED_NO_MAP:
            return "no map yet"
        no_laser = stopped is NavigatorState.STOPPED_NO_LASER
        what, last = ("scan", self._sweep) if no_laser else ("pose", self._pose)
        age = " yet" if last is None else f" for {self._clock() - last[1]:.1f} s"
        return f"no {what}{age}{self.unusable if no_laser else ''}"

    def _is_old(self, seen: _Seen | tuple[NDArray[np.float64], float] | None) -> bool:
        return seen is None or self._clock() - seen[1] > self.settings.stale_s

    def _renew(self) -> None:
        """Reset the progress towards the goal."""
        self.follower.follow(())
        self._progress.restart()
        self._planned_s, self._moved_s = -math.inf, self._clock()
        self._cost_m = self._best_m = math.inf
        self._detours = self.recoveries = 0

    def _plan(self, situation: _Situation) -> None:
        """Follow a new path; if there is none, recover or give up."""
        self._planned_s = self._clock()
        self.grid = situation.costmap.grid(self._obstacles, self._clock())
        way = self._find(situation, self.grid)
        if way.obstruction is Obstruction.NONE:
            self._take(way)
            return
        self.follower.follow(())
        if way.obstruction in (Obstruction.BLOCKED, Obstruction.ROBOT):
            self._recover(way.obstruction)
        else:
            self._end(NavigatorState.UNREACHABLE, way.obstruction)

    def _find(self, situation: _Situation, grid: NavigationGrid) -> Way:
        """Plan on the map with live obstacles; if that fails, check whether the map alone has a path."""
        way = self._way(situation, grid)
        if way.obstruction is Obstruction.NONE:
            return way
        on_map = self._way(situation, situation.costmap.static_grid)
        if on_map.obstruction is Obstruction.NONE:
            return Way(Obstruction.BLOCKED)
        if (unseen := self._way_through_unknown(situation, on_map.obstruction)) is not None:
            return unseen
        if on_map.obstruction in (Obstruction.ROBOT, Obstruction.NO_WAY):
            return self._way_through_narrow(situation, grid, on_map.obstruction)
        return on_map

    def _way_through_unknown(self, situation: _Situation, obstruction: Obstruction) -> Way | None:
        """Plan through what was never seen or has gone, if the robot may, and the map alone has no path."""
        if not self.settings.enters_unknown or obstruction not in PASSABLE:
            return None
        grid = situation.costmap.opened(self._obstacles, self._clock(), situation.goal)
        way = None if grid is None else self._way(situation, grid)
        return way if way is not None and way.obstruction is Obstruction.NONE else None

    def _way_through_narrow(
        self, situation: _Situation, grid: NavigationGrid, obstruction: Obstruction
    ) -> Way:
        """Plan with the smaller clearance, because the robot may have entered a narrow place unknowingly."""
        settings = self.settings
        tight = grid.around_robot(situation.pose, settings.body_radius_m, settings.tight_clearance_m)
        way = self._way(situation, tight)
        return way if way.obstruction is Obstruction.NONE else Way(obstruction)

    def _way(self, situation: _Situation, grid: NavigationGrid) -> Way:
        settings = self.settings
        return plan_way(grid, situation.pose, situation.goal[:2], settings.snap_m, settings.tolerance_m)

    def _take(self, way: Way) -> None:
        """Follow a new path, unless there has been no progress for too long."""
        if way.cost_m > self._cost_m + DETOUR_M:
            self._detours += 1
            self._best_m = math.inf
            self._progress.restart()
        if way.cost_m < self._best_m - PROGRESS_M:
            self._best_m, self.recoveries = way.cost_m, 0
        self._cost_m = way.cost_m
        self.follower.follow(way.path)
        idle_s = self._progress.idle_s(way.path[-1], way.cost_m, self._clock())
        if self._detours > self.settings.max_detours:
            self._end(NavigatorState.UNREACHABLE, "the path was blocked repeatedly")
        elif idle_s > self.settings.patience_s:
            self._recover("no progress towards the goal")

    def _along_path(self, situation: _Situation) -> Velocity:
        if self.follower.is_arrived(situation.pose):
            self.machine.go(NavigatorState.ALIGN, "at the goal's position")
            return HALT
        allowed = self._kept_out(
            situation, self._local.velocity(situation.pose, situation.points, situation.loose)
        )
        if allowed != HALT:
            self._moved_s = self._clock()
        elif self._clock() - self._moved_s > self.settings.blocked_s:
            self._recover("an obstacle blocks the path")
        return allowed

    def _kept_out(self, situation: _Situation, velocity: Velocity) -> Velocity:
        """Return the speeds, or HALT if they would bring the robot into a no-go area."""
        linear_m_per_s, angular_rad_per_s = velocity
        turned_rad = angular_rad_per_s * FORESEEN_S / 2
        ahead_m = linear_m_per_s * FORESEEN_S
        along = (ahead_m * math.cos(turned_rad), ahead_m * math.sin(turned_rad), 0.0)
        grid = situation.costmap.static_grid
        enters = grid.forbids(compose(situation.pose, along)) and not grid.forbids(situation.pose)
        return HALT if enters else velocity

    def _aligned(self, situation: _Situation) -> Velocity:
        """Turn to the goal's heading, faster if the remaining angle is larger."""
        off_rad = float(wrap_angle(situation.goal[2] - situation.pose[2]))
        if abs(off_rad) <= self.settings.heading_tolerance_rad:
            self._end(NavigatorState.ARRIVED, "goal reached")
            return HALT
        speed = min(max(abs(off_rad) * ALIGN_PER_S, LEAST_ALIGN_RAD_PER_S), MOST_ALIGN_RAD_PER_S)
        return 0.0, math.copysign(speed, off_rad)

    def _recover(self, reason: str) -> None:
        """Try the next recovery; give up the goal after too many."""
        if self.recoveries == self.settings.max_recoveries:
            self._end(NavigatorState.UNREACHABLE, f"{reason}; {self.recoveries} recovery attempts failed")
            return
        action = RECOVERIES[self.recoveries % len(RECOVERIES)]
        self.recoveries += 1
        self._progress.restart()
        if action is NavigatorState.CLEAR_COSTMAP:
            self._obstacles.forget()
        self.machine.go(action, reason)

    def _end(self, state: NavigatorState, reason: str) -> None:
        self.follower.follow(())
        self.machine.go(state, reason)
