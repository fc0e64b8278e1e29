"""The task of exploring: from maps, poses and sweeps to the speeds of the drive, with a state machine."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.exploration.exploration import ExplorationPlan, FrontierExploration, PlanResult
from robbie_robots.workers.exploration.explorer_states import TRANSITIONS, ExplorerSettings, ExplorerState
from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep, UnusableSweeps
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.path_follower import HALT, PathFollower, Velocity
from robbie_robots.workers.navigation.progress_watch import ProgressWatch

RECOVER_M_PER_S = 0.15
RECOVER_RAD_PER_S = 0.8
SAME_PLACE_M = 0.5


class _Senses(NamedTuple):
    """The recent inputs that the robot needs in order to drive."""

    grid: NavigationGrid
    pose: NDArray[np.float64]
    points: NDArray[np.float64]  # near the robot, as the guard expects them


class Explorer:
    """Explores a place and drives home. Call `drive` at 10 to 20 Hz.

    Args:
        clock: Returns the time in s; the stamps of all inputs are in this time.
        guard: Checks every command against the newest sweep.
        settings: Settings of the task.
        follower: Steers along the planned ways.
        home_xy_m: Where to return to; the first pose if absent.

    Attributes:
        machine: The task's state, and the reason for the last transition.
        plan: The newest plan: path, goal and frontiers.
        exploring_ended: Why exploring ended; None before that.
        home_xy_m: `(2,)`, m, map frame; None before the first pose.
        unusable: Counts the sweeps that were not taken.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        guard: CollisionGuard,
        settings: ExplorerSettings | None = None,
        follower: PathFollower | None = None,
        home_xy_m: ArrayLike | None = None,
    ) -> None:
        self.settings = settings or ExplorerSettings()
        self.machine = StateMachine(ExplorerState.WAIT, TRANSITIONS, clock)
        self.plan = ExplorationPlan(PlanResult.NO_WAY)
        self.exploring_ended: str | None = None
        self.home_xy_m = None if home_xy_m is None else np.asarray(home_xy_m, float)
        self._clock = clock
        self._guard = guard
        self._follower = follower or PathFollower()
        self._exploration = FrontierExploration()
        self._progress = ProgressWatch()
        self._grid: NavigationGrid | None = None
        self._pose: tuple[NDArray[np.float64], float] | None = None
        self._sweep: tuple[LaserSweep, float] | None = None
        self.unusable = UnusableSweeps()
        self._stamps_s = [-math.inf, -math.inf]  # of the newest pose and sweep
        self._hold = ""
        self._planned_s = -math.inf
        self._began_s = math.inf
        self._moved_s = -math.inf
        self._explored_plans = 0
        self._recoveries = 0
        self._stuck_xy_m: NDArray[np.float64] | None = None

    @property
    def state(self) -> ExplorerState:
        """Return the current state."""
        return self.machine.state

    @property
    def status(self) -> str:
        """Return state, reason and known area in one line."""
        known_m2 = self._grid.known_m2 if self._grid is not None else 0.0
        return (
            f"{self.state} ({self.machine.reason}); {known_m2:.1f} m2 free, "
            f"{len(self.plan.frontiers)} frontiers, {len(self._exploration.avoided_xy_m)} goals given up"
            f"{self.unusable}"
        )

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        """Take a new map: see `NavigationGrid` for the arguments."""
        self._grid = NavigationGrid(cells, resolution_m, corner_xy_m, self.settings.clearance_m)

    def see_hold(self, reason: str) -> None:
        """Take the reason why the robot must stand until somebody orders it to go on; '' if it may drive."""
        self._hold = reason

    @property
    def rests_on_s(self) -> float:
        """Return the stamp of the oldest input on which the speeds rest, s; -inf before the first."""
        return min(self._stamps_s)

    def see_pose(self, pose: ArrayLike, stamp_s: float, told_s: float) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame.

        Args:
            pose: the pose.
            stamp_s: when the robot was there, on the clock of the stamps.
            told_s: when it was published, on the clock of `drive`.
        """
        self._pose = np.asarray(pose, float), told_s
        self._stamps_s[0] = stamp_s
        if self.home_xy_m is None:
            self.home_xy_m = self._pose[0][:2]

    def see_sweep(self, sweep: LaserSweep, stamp_s: float, told_s: float) -> None:
        """Take a sweep, unless it is unusable, which counts as no sweep; stamps as for `see_pose`."""
        if self.unusable.passes(sweep):
            self._sweep = sweep, told_s
            self._stamps_s[1] = stamp_s

    def drive(self) -> Velocity:
        """Return the speeds for the drive: forward (m/s) and turn rate (rad/s)."""
        if self.machine.is_final:
            return HALT
        senses = self._senses()
        if senses is None:
            if self.state is not ExplorerState.WAIT:
                self.machine.go(ExplorerState.WAIT, self._hold or "pose or laser is missing or too old")
            return HALT
        if self.state is ExplorerState.WAIT:
            self._resume("map, pose and laser are available")
        if self.state is ExplorerState.RECOVER:
            return self._free_itself(senses.points)
        if self._clock() - self._planned_s >= self.settings.plan_period_s:
            self._make_plan(senses.grid, senses.pose)
        if self.state not in (ExplorerState.EXPLORE, ExplorerState.RETURN):
            return HALT
        return self._along_path(senses)

    def _senses(self) -> _Senses | None:
        """Return map, pose and ranges; None if one is missing or too old."""
        if self._hold or self._grid is None or self._pose is None or self._sweep is None:
            return None
        (pose, pose_s), (sweep, sweep_s) = self._pose, self._sweep
        if self._clock() - min(pose_s, sweep_s) > self.settings.stale_s:
            return None
        return _Senses(self._grid, pose, self._guard.near_points([MountedSweep(sweep)]))

    def _resume(self, reason: str) -> None:
        """Resume exploring or returning, with a new plan."""
        self._began_s = min(self._began_s, self._clock())
        self._planned_s = -math.inf
        self._moved_s = self._clock()
        self._progress.restart()
        self.machine.go(ExplorerState.RETURN if self.exploring_ended else ExplorerState.EXPLORE, reason)

    def _make_plan(self, grid: NavigationGrid, pose: NDArray[np.float64]) -> None:
        self._planned_s = self._clock()
        if self.state is ExplorerState.EXPLORE:
            self.plan = self._exploration.plan_exploration(grid, pose)
            self._follower.follow(self.plan.path)
            self._judge_exploration(pose)
        elif self.home_xy_m is not None:  # there has been a pose, so there is a home
            self.plan = self._exploration.plan_way_to(grid, pose, self.home_xy_m)
            self._follower.follow(self.plan.path)
            self._judge_return(pose)

    def _judge_exploration(self, pose: NDArray[np.float64]) -> None:
        # A single map may be incomplete, so two in a row are required.
        self._explored_plans = self._explored_plans + 1 if self.plan.result is PlanResult.EXPLORED else 0
        if self._clock() - self._began_s > self.settings.time_limit_s:
            self._end_exploration("the time limit is reached")
        elif self._explored_plans >= 2:
            self._end_exploration(PlanResult.EXPLORED)
        elif self.plan.result is PlanResult.NO_WAY:
            self._recover(self.plan.result, pose)
        elif self._is_idle():
            self._exploration.give_up_goal()
            self._progress.restart()

    def _judge_return(self, pose: NDArray[np.float64]) -> None:
        if self._follower.is_arrived(pose):
            self.machine.go(ExplorerState.DONE, "at home")
        elif self.plan.result is PlanResult.NO_WAY or self._is_idle():
            self._recover("no progress towards home", pose)

    def _is_idle(self) -> bool:
        """Return whether there has been no progress towards the goal for too long."""
        if self.plan.goal_xy_m is None:
            return False
        idle_s = self._progress.idle_s(self.plan.goal_xy_m, self.plan.cost_m, self._clock())
        return idle_s > self.settings.patience_s

    def _end_exploration(self, reason: str) -> None:
        self.exploring_ended = reason
        self._recoveries = 0
        self._progress.restart()
        self._planned_s = -math.inf
        self._follower.follow(())
        self.machine.go(ExplorerState.RETURN if self.settings.returns_home else ExplorerState.DONE, reason)

    def _recover(self, reason: str, pose: NDArray[np.float64]) -> None:
        """Try to free the robot; give up after several failed attempts at one place."""
        here = pose[:2]
        if self._stuck_xy_m is None or np.hypot(*(here - self._stuck_xy_m)) > SAME_PLACE_M:
            self._stuck_xy_m, self._recoveries = here, 0
        self._recoveries += 1
        if self._recoveries <= self.settings.max_recoveries:
            self.machine.go(ExplorerState.RECOVER, reason)
        elif self.state is ExplorerState.EXPLORE:
            self._end_exploration(f"stuck: {reason}")
        else:
            self.machine.go(ExplorerState.DONE, f"stuck: {reason}")

    def _along_path(self, senses: _Senses) -> Velocity:
        wanted = self._follower.velocity(senses.pose)
        allowed = self._guard.checked(senses.points, wanted)
        if wanted[0] == 0.0 or allowed[0] != 0.0:
            self._moved_s = self._clock()
        elif self._clock() - self._moved_s > self.settings.blocked_s:
            self._recover("an obstacle blocks the path", senses.pose)
            return HALT
        return allowed

    def _free_itself(self, points: NDArray[np.float64]) -> Velocity:
        """Back up as far as the laser allows; otherwise turn on the spot to see more."""
        if self.machine.time_in_state_s > self.settings.recover_s:
            self._resume("recovery finished")
            return HALT
        backwards = self._guard.checked(points, (-RECOVER_M_PER_S, 0.0))
        return backwards if backwards[0] != 0.0 else (0.0, RECOVER_RAD_PER_S)
