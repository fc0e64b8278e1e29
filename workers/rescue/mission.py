"""The rescue mission: from map, pose, navigation and victims to goals, with a state machine.

The mission decides; it does not drive. Call `step` a few times each second and carry out what it returns.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.exploration.frontiers import Frontier
from robbie_robots.workers.exploration.team_claims import Claim, TeamClaims
from robbie_robots.workers.rescue.mission_limits import MissionLimits
from robbie_robots.workers.rescue.mission_orders import OperatorOrder, OperatorOrders
from robbie_robots.workers.rescue.mission_states import (
    ENDS,
    TIME_OUTS,
    TRANSITIONS,
    MissionSettings,
    MissionState,
)
from robbie_robots.workers.rescue.mission_targets import (
    MissionMap,
    MissionTargets,
    RescueTarget,
    SearchedGrid,
)
from robbie_robots.workers.rescue.mission_victims import MissionVictims
from robbie_robots.workers.rescue.right_of_way import RightOfWay

Points = NDArray[np.float64]

PATH_STEP_M = 0.05
TRAVELS = frozenset({MissionState.EXPLORE, MissionState.SEARCH, MissionState.APPROACH})
WORKS = TRAVELS | {MissionState.LOOK, MissionState.INSPECT, MissionState.ASK}
STANDS = frozenset({MissionState.WAIT, MissionState.HALT, MissionState.PAUSE})
LOOKS = {MissionState.SEARCH: MissionState.LOOK, MissionState.APPROACH: MissionState.INSPECT}
EMPTY_PLANS = 3
"""One map may be incomplete. The mission ends its work only after this many maps in a row show none left."""
HOME_ATTEMPTS = 5
NOTHING_LEFT = "nothing is left to do"
LEFT_TO_OTHERS = "the rest is left to other robots"
GIVES_WAY = WORKS | {MissionState.RETURN}
SAME_TARGET_M = 0.3


@dataclass(frozen=True)
class RescueOrder:
    """The robot's current order.

    Attributes:
        goal: `(3,)`, x, y (m) and heading (rad), map frame. None: stand still.
        look_at_xy_m: `(2,)`, m, map frame. None: look around.
    """

    goal: Points | None = None
    look_at_xy_m: Points | None = None


class Mission:
    """Carries out one mission.

    Args:
        clock: Returns the time in s. The stamps of all inputs use the same clock.
        settings: How to carry out the mission.
        on_change: Called with each new state.

    Attributes:
        machine: The state machine, and why it entered the current state.
        victims: What the mission knows about the victims.
        limits: What time and battery still allow.
        notes: What went wrong, for the report. Each note is listed once.
        home: `(3,)`, the pose where the mission began. None before the first pose.
        operator: What the operator has ordered.
        path_m: where the robot has been, m, map frame.
        collisions: how often the bumper has been pressed. None: no bumper has reported.
        claims: what other robots drive to.
        away: devices that are disconnected.
        number: the number of this mission in the run, from 1.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        settings: MissionSettings | None = None,
        on_change: Callable[[MissionState], None] = lambda _state: None,
    ) -> None:
        self.settings = settings or MissionSettings()
        self.machine = StateMachine(MissionState.WAIT, TRANSITIONS, clock, TIME_OUTS, on_change)
        self.victims = MissionVictims()
        self.limits = MissionLimits(clock, self.settings)
        self.notes: list[str] = []
        self.home: Points | None = None
        self.operator = OperatorOrders(self.settings.starts_by_itself)
        self.path_m: list[tuple[float, float]] = []
        self.collisions: int | None = None
        self.claims = TeamClaims(clock)
        self.away: list[str] = []
        self.number = 1
        self._devices: set[str] = set()
        self._right_of_way = RightOfWay(clock)
        self._way_m = 0.0
        self._touches = False
        self._clock, self._on_change = clock, on_change
        self._targets = MissionTargets(self.settings)
        self._target: RescueTarget | None = None
        self._around: MissionMap | None = None
        self._searched: SearchedGrid | None = None
        self._pose: Points | None = None
        self._camera_s = self._searched_s = clock()
        self._stopped: str | None = "navigation does not report"
        self._planned_s = -math.inf
        self._empty_plans = 0
        self._home_attempts = 0
        self._last_goal: Points | None = None
        self._ended: str | None = None
        self._is_over_time = False
        """The operator has called the robot home after the end of its mission, when no limit counts."""
        self._known_at_end: set[int] = set()

    @property
    def state(self) -> MissionState:
        """Return what the robot does."""
        return self.machine.state

    @property
    def status(self) -> str:
        """Return what the robot does, why, and what it has found, in one line."""
        reason = "for the operator's start" if self.operator.is_awaited else self.machine.reason
        away = f"; DISCONNECTED: {', '.join(self.away)}" if self.away else ""
        return f"{self.state} ({reason}); {self.victims.summary}; {self.limits.summary}{away}"

    @property
    def frontiers(self) -> list[Frontier]:
        """Return the frontiers of the map at the robot's last planning step, longest first."""
        return self._targets.frontiers

    @property
    def searched(self) -> SearchedGrid | None:
        """Return which walls were searched. None before the first report."""
        return self._searched

    @property
    def has_ended(self) -> bool:
        """Return whether the mission has ended; the operator may start another one."""
        return self.state in ENDS

    @property
    def is_working(self) -> bool:
        """Return whether the robot works, or may find work again."""
        return self._ended is None and not self.has_ended

    @property
    def claim(self) -> Claim | None:
        """Return what this robot does, for the others. None before the first pose."""
        if self._pose is None:
            return None
        target = self._target
        return Claim(
            pose=self._pose,
            goal=self._orders().goal,
            target_xy_m=None if target is None else target.about_xy_m,
            way_m=self._way_m if self.state in TRAVELS else 0.0,
            is_working=self.is_working,
            home_xy_m=None if self.home is None else self.home[:2],
            seen_in_vain=self._targets.seen_in_vain,
        )

    # -- inputs ----------------------------------------------------------------------------------------

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        """Take a new map. `MissionMap` describes the arguments."""
        self._around = MissionMap(cells, resolution_m, corner_xy_m, self.settings)

    def see_searched(self, searched: SearchedGrid) -> None:
        """Record which walls were searched."""
        self._searched, self._searched_s = searched, self._clock()

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._pose = np.asarray(pose, float)
        if not self.operator.has_begun:
            self.home = self._pose
        x, y = self._pose[:2].tolist()
        if not self.path_m or math.dist(self.path_m[-1], (x, y)) >= PATH_STEP_M:
            self.path_m.append((x, y))

    def see_camera(self) -> None:
        """Record that the camera works."""
        self._camera_s = self._clock()

    def see_bumper(self, *, is_pressed: bool) -> None:
        """Count the times at which the bumper begins to touch something."""
        self.collisions = (self.collisions or 0) + (is_pressed and not self._touches)
        self._touches = is_pressed

    def see_stopped(self, reason: str | None) -> None:
        """Record why the robot cannot drive. None: it can."""
        if reason is not None and self._stopped is None:
            self._note(f"stopped: {reason}")
        self._stopped = reason

    def see_device(self, name: str, *, is_connected: bool) -> None:
        """Record whether a device can be used; before it was connected once, it does not count as away."""
        if is_connected:
            self._devices.add(name)
            self.away = [one for one in self.away if one != name]
        elif name in self._devices and name not in self.away:
            self.away = [*self.away, name]
            self._note(f"{name} was disconnected")

    def order(self, order: int) -> str | None:
        """Carry out an `OperatorOrder`, or return why the mission refuses it."""
        refusal = self.operator.refusal(order, self.state)
        if refusal is None:
            self.operator.is_held = order == OperatorOrder.PAUSE
            if order == OperatorOrder.ABORT:
                self._end(MissionState.ABORTED, "aborted by the operator")
            elif order == OperatorOrder.RETURN:
                self._is_over_time |= self.has_ended
                self._home_attempts = 0
                self._return("ordered by the operator")
        return refusal

    def arrived(self) -> None:
        """Record that the robot has reached its latest goal."""
        if self.state is MissionState.RETURN:
            self._judge_home("is home")
        elif self.state in LOOKS:
            self.machine.go(LOOKS[self.state], "is there")
        elif self.state is MissionState.EXPLORE:
            self._give_up_target(was_there=True)

    def unreachable(self, reason: str) -> None:
        """Record that the robot cannot reach its latest goal."""
        if self.state is MissionState.RETURN:
            self._judge_home(reason)
        elif self.state in TRAVELS:
            self._give_up_target(was_there=False)

    # -- outputs ---------------------------------------------------------------------------------------

    def step(self) -> RescueOrder:
        """Decide what the robot does now, and return it."""
        if self.has_ended:
            return RescueOrder()
        if self.operator.is_awaited:
            self.limits.begin()
        if self._around is None or self._pose is None:
            return self._wait()
        self._judge()
        self.limits.hold(is_held=self.settings.pause_stops_time and self.state is MissionState.PAUSE)
        plans = self.state in WORKS or self._waits_for_others
        if self._clock() - self._planned_s >= self.settings.plan_period_s and plans:
            self._planned_s = self._clock()
            self._plan()
        return self._orders()

    def _wait(self) -> RescueOrder:
        if self.limits.is_over:
            self._end(MissionState.FAILED, "the time is over, and it never began")
        return RescueOrder()

    def _judge(self) -> None:
        """Change the state if an input requires it."""
        if self.limits.is_over and not self._is_over_time:
            self._end(MissionState.FAILED, "the time is over")
        elif self.operator.is_held:
            if self.operator.has_begun and self.state is not MissionState.PAUSE:
                self.machine.go(MissionState.PAUSE, "ordered by the operator")
        elif self._stopped is not None:
            if self.state not in (MissionState.HALT, MissionState.WAIT):
                self.machine.go(MissionState.HALT, self._stopped)
        elif self.state in STANDS:
            self.operator.has_begun = True
            self._go_on("resumed by the operator" if self.state is MissionState.PAUSE else "it can drive")
        elif self._must_give_way():
            if self.state is not MissionState.GIVE_WAY:
                self._target = None
                self.machine.go(MissionState.GIVE_WAY, "their ways meet")
        elif self.state is MissionState.GIVE_WAY:
            self._go_on("the way is free")
        elif self.state is not MissionState.RETURN:
            self._judge_work()
        elif self._ended == NOTHING_LEFT and self.victims.suspected_ids - self._known_at_end:
            self._ended = None
            self._go_on("a victim was seen on the way home")

    def _must_give_way(self) -> bool:
        """Return whether the robot must let another one pass."""
        if self.state not in GIVES_WAY and self.state is not MissionState.GIVE_WAY:
            return False
        assert self._around is not None
        assert self._pose is not None
        current = self.claims.current
        first = [claim for robot, claim in current.items() if robot in self.settings.gives_way_to]
        goal = self._last_goal if self.state is MissionState.GIVE_WAY else self._orders().goal
        self._last_goal = goal
        return self._right_of_way.check(self._around, self._pose, goal, first)

    @property
    def _waits_for_others(self) -> bool:
        """Return whether the robot is on its way home, or there, because only other robots have work."""
        return self.state is MissionState.RETURN and self._ended == LEFT_TO_OTHERS

    def _judge_work(self) -> None:
        """Change the state, where necessary, during the working part of the mission."""
        if self.state is MissionState.ASK and not self.victims.is_asked:
            self._go_on("the operator was asked")
        elif self.state is not MissionState.ASK and self.victims.is_asked and not self.victims.is_waited_for:
            self.machine.go(MissionState.ASK, f"asks about {self.victims.asked_name}")
            self.victims.wait_for_answer()
        elif self.state is MissionState.INSPECT and self._target_is_done():
            self._target = None
            self._go_on("the victim was seen well")
        elif self.state is MissionState.LOOK and self._target_is_searched():
            self._target = None
            self._go_on("the wall was seen well")
        elif self.machine.expire():
            self._give_up_target(was_there=True)
        elif self.state in TRAVELS and self.machine.time_in_state_s > self.settings.travel_s:
            self._give_up_target(was_there=False)
            self.machine.go(MissionState.EXPLORE, "that took too long")

    def _target_is_done(self) -> bool:
        return self._target is None or not self.victims.is_suspected_at(self._target.about_xy_m)

    def _target_is_searched(self) -> bool:
        if self._target is None or self._searched is None:
            return True
        return bool(self._searched.holds(self._target.about_xy_m[None])[0])

    def _go_on(self, reason: str) -> None:
        self._planned_s = -math.inf
        self.machine.go(MissionState.RETURN if self._ended else MissionState.EXPLORE, reason)

    def _plan(self) -> None:
        """Go home if it is time; while the robot travels, choose what to do next."""
        assert self._around is not None
        assert self._pose is not None
        way_home_m = self._around.way_m(self._pose, self.home[:2]) if self.home is not None else 0.0
        if (hurry := self.limits.must_return(way_home_m)) is not None:
            if self._waits_for_others:
                self._ended = hurry
            else:
                self._return(hurry)
        if self.state not in TRAVELS and not self._waits_for_others:
            return
        searched, suspected = self._searched_walls(), self.victims.suspected
        target, can_drive = self._targets.best(
            self._around, self._pose, searched, suspected, self._target, self.claims, self.home
        )
        self._empty_plans = self._empty_plans + 1 if target is None and can_drive else 0
        if self._waits_for_others:
            if target is not None:
                self._ended = None
                self._go_on("there is work after all")
            elif self._empty_plans >= EMPTY_PLANS and not self.claims.is_anyone_working:
                self._ended = NOTHING_LEFT
        elif self._empty_plans >= EMPTY_PLANS:
            waits = self._targets.are_left_to_others or self.claims.is_anyone_working
            self._return(LEFT_TO_OTHERS if waits else NOTHING_LEFT)
        elif target is not None:
            self._take(target)

    def _take(self, target: RescueTarget) -> None:
        """Take a target, unless it is almost the current one: each new goal restarts navigation."""
        old, self._way_m = self._target, target.way_m
        is_same = old is not None and old.state is target.state is self.state
        if old is not None and is_same and math.dist(old.about_xy_m, target.about_xy_m) <= SAME_TARGET_M:
            return
        self._target = target
        self.machine.go(target.state, f"at {target.about_xy_m[0]:.1f}, {target.about_xy_m[1]:.1f}")

    def _searched_walls(self) -> SearchedGrid | None:
        """Return which walls were searched. None if no camera works."""
        for seen_s, what in ((self._camera_s, "the camera"), (self._searched_s, "the search for victims")):
            if self._clock() - seen_s > self.settings.silent_s:
                self._note(f"{what} is silent: the mission continues without victims")
                return None
        return self._searched

    def _return(self, reason: str) -> None:
        self._ended = reason
        self._known_at_end = set(self.victims.reports)
        self._target = None
        self.machine.go(MissionState.RETURN, reason)

    def _judge_home(self, reason: str) -> None:
        """End the mission at home; try again if the robot is not quite there."""
        assert self.home is not None
        assert self._pose is not None
        away_m = float(np.hypot(*(self._pose - self.home)[:2]))
        if self._waits_for_others and away_m <= self.settings.arrived_m:
            return
        self._home_attempts += 1
        if away_m <= self.settings.arrived_m or self._home_attempts >= HOME_ATTEMPTS:
            is_home = away_m <= self.settings.arrived_m
            end = MissionState.DONE if is_home else MissionState.FAILED
            self._end(end, "is home" if is_home else f"{away_m:.1f} m from home: {reason}")

    def _end(self, state: MissionState, reason: str) -> None:
        self._target = None
        self.machine.go(state, reason)

    def _give_up_target(self, *, was_there: bool) -> None:
        if self._target is not None:
            self._targets.give_up(self._target, was_there=was_there)
        self._target = None
        self._planned_s = -math.inf

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

    def _orders(self) -> RescueOrder:
        if self.state is MissionState.RETURN:
            return RescueOrder(self.home)
        if self.state is MissionState.GIVE_WAY:
            return RescueOrder(self._right_of_way.aside)
        if self._target is None:
            return RescueOrder()
        about = None if self.state is MissionState.EXPLORE else self._target.about_xy_m
        return RescueOrder(self._target.goal if self.state in TRAVELS else None, about)

    # -- restarts --------------------------------------------------------------------------------------

    def following(self) -> "Mission":
        """Return the next mission of this robot. It begins where the robot stands, and knows the victims."""
        settings = replace(self.settings, starts_by_itself=True)
        following = Mission(self._clock, settings, self._on_change)
        following.number = self.number + 1
        following.victims, following.claims, following.collisions = self.victims, self.claims, self.collisions
        following.operator.must_order = self.operator.must_order
        following.away, following._devices = self.away, self._devices
        following._stopped = self._stopped
        return following

    def memory(self) -> dict[str, Any]:
        """Return what a restarted mission needs to go on, as plain data."""
        return {
            "over": (self.state.name, self.machine.reason) if self.has_ended else None,
            "number": self.number,
            "is_over_time": self._is_over_time,
            "is_held": self.operator.is_held,
            "has_begun": self.operator.has_begun,
            "home": self.home,
            "path_m": np.array(self.path_m).reshape(-1, 2),
            "ended": self._ended,
            "notes": list(self.notes),
            "given_up": self._targets.memory(),
            "victims": self.victims.memory(),
            "limits": self.limits.memory(),
            "collisions": self.collisions,
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Continue from the data that `memory` returned."""
        self.home = memory["home"]
        self.path_m = [(x, y) for x, y in memory["path_m"].tolist()]
        self._ended = memory["ended"]
        self.notes = list(memory["notes"])
        self._targets.remember(memory["given_up"])
        self.victims.remember(memory["victims"])
        self._known_at_end = set(self.victims.reports)
        self.limits.remember(memory["limits"])
        self.collisions = memory["collisions"]
        self.operator.is_held, self.operator.has_begun = memory["is_held"], memory["has_begun"]
        self.number, self._is_over_time = memory["number"], memory["is_over_time"]
        if memory["over"] is not None:
            state, reason = memory["over"]
            self._end(MissionState[state], reason)
