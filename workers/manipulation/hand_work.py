"""Picks up objects from a table, and puts them down or hands them over, step by step."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.base.procedure import Failed, Procedure, pause
from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.manipulation.arm_model import ArmModel
from robbie_robots.workers.manipulation.collisions import CollisionWorld, Shape
from robbie_robots.workers.manipulation.errors import ManipulationError, Unreachable
from robbie_robots.workers.manipulation.grasps import grasps, moved_along, places
from robbie_robots.workers.manipulation.hand_work_states import (
    TIME_OUTS,
    TRANSITIONS,
    HandSettings,
    HandState,
    HandTask,
)
from robbie_robots.workers.manipulation.planning import plan, reach, straight_line
from robbie_robots.workers.manipulation.table_view import TableView
from robbie_robots.workers.manipulation.trajectory import Trajectory

Floats = NDArray[np.float64]

MARGINS_M = (0.01, 0.003, 0.0)
"""Distances from obstacles, tried in this order: the arm may stand nearer to one than the first allows."""
GRASP_RESTARTS = 6
ARRIVED_RAD = 0.02
STOWED_RAD = 0.1
GIVES_AWAY = {HandState.OFFER, HandState.OPEN, HandState.WITHDRAW}
WRIST_PITCH = 4
"""Place of the joint that turns the hand up and down, if the forearm lies level."""
LOOKS_AGAIN_S = 3.0
"""The arm looks at least for this time for an object that it does not see."""
MAX_GRASPS = 60
"""Poses of the hand that are tried for one object or place."""


class JointOrder(NamedTuple):
    """Where the joints should be now: (joints,) rad, and half of the gripper's opening."""

    positions: Floats
    half_opening_m: float


@dataclass(frozen=True)
class HandOutcome:
    """How an order ended: done, or why not."""

    is_done: bool
    text: str


class HandWork:
    """Carries out one order at a time; `step` says where the joints should be.

    Args:
        arm: the arm.
        clock: returns the time in s, of the stamps that it is given.
        settings: how to work.
        on_change: called with each new state.
        seed: of random choices.

    Attributes:
        machine: its state.
        held: what is in the hand, with X_TO as its pose; None: nothing.
        outcome: how the last order ended; None while it works, and before the first one.
        tries: number of grasps that the order has taken.
    """

    def __init__(
        self,
        arm: ArmModel,
        clock: Callable[[], float],
        settings: HandSettings | None = None,
        on_change: Callable[[HandState], None] = lambda _state: None,
        seed: int = 0,
    ) -> None:
        self._arm, self._clock, self.settings = arm, clock, settings or HandSettings()
        self._chance = np.random.default_rng(seed)
        self.machine = StateMachine(HandState.REST, TRANSITIONS, clock, TIME_OUTS, on_change)
        self.task: HandTask | None = None
        self.target = ""
        self.held: Shape | None = None
        self.outcome: HandOutcome | None = None
        self.tries = 0
        self.view: TableView | None = None
        self._is_released = False
        """Whether the object that was to be put down or handed over has been let go."""
        self._problem = ""
        """Why the order has failed, while the arm is stowed; then the order ends."""
        self._grasp: Shape | None = None
        """What the gripper closes, or has closed, around."""
        self._positions: Floats | None = None
        self._half_m = 0.0
        self._heard_s = -math.inf
        self._efforts: Floats | None = None
        self._calm_efforts: Floats | None = None
        """The joints' torques before anybody pulls at what the arm holds out."""
        self._halves: deque[tuple[float, float]] = deque(maxlen=200)
        self._opening_m = arm.opening_m
        self._way: Trajectory | None = None
        self._way_began_s = 0.0
        self._line: Floats | None = None
        self._work = Procedure[HandOutcome]()

    # -- what it is told ---------------------------------------------------------------------------------

    def see_joints(self, positions: Floats, half_opening_m: float, stamp_s: float) -> None:
        """Take where the joints are."""
        self._positions, self._half_m, self._heard_s = positions, half_opening_m, stamp_s
        self._halves.append((stamp_s, half_opening_m))

    def see_efforts(self, efforts: Floats) -> None:
        """Take the torques of the joints: (joints,), Nm. Without them, the arm feels nobody pull."""
        self._efforts = efforts

    def see_table(self, view: TableView) -> None:
        """Take what the camera sees; it counts only while the arm is out of its view and stands."""
        since_s = self._clock() - self.machine.time_in_state_s
        if self.machine.state is HandState.LOOK and view.stamp_s >= since_s + self.settings.settle_s:
            self.view = view

    @property
    def half_opening_m(self) -> float:
        """Return half of the gripper's opening."""
        return self._half_m

    def pick_up(self, name: str) -> None:
        """Begin to pick up an object; an order before ends."""
        self._begin(HandTask.PICK_UP, name)

    def put_down(self) -> None:
        """Begin to put down what is held; an order before ends."""
        self._begin(HandTask.PUT_DOWN, self.held.name if self.held is not None else "")

    def hand_over(self) -> None:
        """Begin to hold out what is held, and let it go when somebody pulls; an order before ends."""
        self._begin(HandTask.HAND_OVER, self.held.name if self.held is not None else "")
        self.view = None  # there is no table

    def stow(self) -> None:
        """Begin to move the arm above the robot, with what it holds; an order before ends."""
        self._begin(HandTask.STOW, self.held.name if self.held is not None else "")

    def stop(self, reason: str) -> None:
        """End the order; the arm stands still."""
        if self.task is not None:
            self._end(HandOutcome(False, reason))

    def _begin(self, task: HandTask, target: str) -> None:
        self.task, self.target, self.tries, self.outcome = task, target, 0, None
        self._is_released, self._problem = False, ""
        self.view = None if self.view is None else replace(self.view, stamp_s=-math.inf)
        self._work.begin(self._carry_out(f"{task} {target}"))

    # -- the order ---------------------------------------------------------------------------------------

    async def _carry_out(self, reason: str) -> HandOutcome:
        """Try until the order is done. Before it fails, stow the arm: the robot will drive on."""
        while True:
            try:
                return await self._attempt(reason)
            except Failed as error:
                reason = str(error)
            except ManipulationError as error:
                reason = str(error)
                self.tries += 1
                has_nothing = self._gives_away and self.held is None and not self._is_released
                if self.tries < self.settings.max_tries and not has_nothing:
                    continue
            if self._problem or self._is_stowed():
                return HandOutcome(False, self._problem or reason)
            self._problem = reason

    async def _attempt(self, reason: str) -> HandOutcome:
        """Do what the order says, and stow the arm."""
        if not await self._recover(reason):
            await self._free()
            is_over = self._is_released or self.task is HandTask.STOW
        elif self.task is HandTask.HAND_OVER and not self._problem:
            await self._let_go(await self._offer())
            is_over = True
        else:
            await self._lift()
            is_over = self.task is not HandTask.PUT_DOWN
        if not is_over and not self._problem:
            await self._look()
            await self._reach()
            if self.task is HandTask.PICK_UP:
                await self._close()
                await self._lift()
            else:
                await self._let_go("there")
        return await self._stow()

    async def _recover(self, reason: str) -> bool:
        """Find out whether the hand holds something."""
        self._enter(HandState.RECOVER, reason)
        self._opening_m = 0.0 if self._grasp is not None else self._arm.opening_m
        self._halves.clear()
        if not await self._until(self._gripper_stands):
            return False
        if self._half_m <= self.settings.empty_m:
            self._grasp = None
        self.held = self._grasp
        if self._problem:
            return self.held is not None
        if self.held is None and self._gives_away and not self._is_released:
            raise Failed("there is nothing in the hand")
        if self.held is not None and self.task is HandTask.PICK_UP and self.held.name != self.target:
            raise Failed(f"the hand holds {self.held.name}")
        return self.held is not None

    async def _free(self) -> None:
        """Open the gripper, and move it away from where it is."""
        self._enter(HandState.FREE, "holds nothing")
        self._opening_m = self._arm.opening_m
        await self._move_hand(ahead_m=-self.settings.back_m)

    async def _look(self) -> None:
        """Look at the table with the arm aside, and choose a way to the object, or to a free place."""
        self._enter(HandState.ASIDE, "has to see the table")
        await self._move(self._plan_to(np.array(self.settings.aside)))
        self._enter(HandState.LOOK, "out of view")
        self.view = None
        self._choose_way(sees_target=await self._until(self._sees_target))

    def _sees_target(self) -> bool:
        if self.view is None or self.task is not HandTask.PICK_UP:
            return self.view is not None
        is_there = self.view.named(self.target) is not None
        if not is_there and self.machine.time_in_state_s < LOOKS_AGAIN_S:
            self.view = None
        return is_there

    def _choose_way(self, *, sees_target: bool) -> None:
        if self.view is None:
            raise Unreachable("sees no table")
        if not sees_target:
            problem = f"sees no {self.target} on a table"
            raise Failed(problem) if self.tries else Unreachable(problem)  # it looks twice
        shape = self.view.named(self.target)
        if self.task is HandTask.PICK_UP and shape is not None:
            self._choose_grasp(self.view, shape)
        else:
            self._choose_place(self.view)

    async def _reach(self) -> None:
        """Move the hand to the object, or to the free place."""
        assert self._line is not None
        self._enter(HandState.APPROACH, f"sees {self.target}" if self.held is None else "sees a free place")
        await self._move(self._plan_to(self._line[0]))
        self._enter(HandState.REACH, "near")
        await self._move(self._line, self.settings.line_speed)

    async def _close(self) -> None:
        """Close the gripper around the object."""
        self._enter(HandState.CLOSE, "there")
        assert self.view is not None
        shape = self.view.named(self.target)
        assert shape is not None
        self._grasp = replace(shape, pose=np.linalg.inv(self._arm.pose(self._here())) @ shape.pose)
        self._opening_m = 0.0
        self._halves.clear()
        if not await self._until(self._gripper_stands) or self._half_m <= self.settings.empty_m:
            await self._let_go("the gripper is empty")
            raise Unreachable(f"the gripper closed, but {self.target} was not in it")
        self.held = self._grasp

    async def _lift(self) -> None:
        """Lift what the hand holds."""
        assert self.held is not None
        self._enter(HandState.LIFT, f"holds {self.held.name}, {2 * self._half_m:.3f} m wide")
        await self._move_hand(up_m=self.settings.lift_m)

    async def _offer(self) -> str:
        """Hold out what the hand holds until somebody takes it; return how that showed."""
        assert self.held is not None
        self._enter(HandState.OFFER, f"holds {self.held.name}")
        self._calm_efforts = None
        offer = np.array(self.settings.offer)
        # The hand has the pitch again that it had when it grasped the object, which stood.
        pitch_rad = -math.asin(float(np.clip(np.linalg.inv(self.held.pose)[2, 0], -1.0, 1.0)))
        offer[WRIST_PITCH] = np.clip(pitch_rad, self._arm.lower[WRIST_PITCH], self._arm.upper[WRIST_PITCH])
        self._follow(self._plan_to(offer), self.settings.speed)
        while not (sign := self._sign_of_taking()):
            await pause()
        return sign

    def _sign_of_taking(self) -> str:
        """Return how it shows that somebody takes what the arm holds out; '' while nobody does."""
        if self._half_m <= self.settings.empty_m:
            return "somebody has taken it"
        if not self._has_arrived():
            return ""
        assert self._way is not None
        held_out_s = self._clock() - self._way_began_s - self._way.duration_s
        if self._calm_efforts is None and held_out_s >= self.settings.still_s:
            self._calm_efforts = self._efforts
        elif self._calm_efforts is not None and self._efforts is not None:
            change_nm = float(np.abs(self._efforts - self._calm_efforts).max())
            if change_nm >= self.settings.pull_nm:
                return f"somebody pulls with {change_nm:.1f} Nm"
        if held_out_s >= self.settings.offer_s:
            raise Failed(f"nobody has taken {self.target}")
        return ""

    async def _let_go(self, reason: str) -> None:
        """Open the gripper, and draw the hand back."""
        self._enter(HandState.OPEN, reason)
        if self.task is HandTask.PUT_DOWN and self.held is not None and self.view is not None:
            # From now on, the arm must keep away from it.
            there = replace(self.held, pose=self._arm.pose(self._here()) @ self.held.pose)
            self.view = replace(self.view, objects=(*self.view.objects, there))
        if self.task is not HandTask.PICK_UP:
            self.held, self._is_released = None, True
        self._opening_m = self._arm.opening_m
        self._grasp = None
        self._halves.clear()
        await self._until(self._gripper_stands)
        self._enter(HandState.WITHDRAW, "open")
        await self._move_hand(ahead_m=-self.settings.back_m)

    async def _stow(self) -> HandOutcome:
        """Move the arm above the robot."""
        self._enter(HandState.STOW, self._problem or "the robot will drive on")
        await self._move(self._plan_to(np.array(self.settings.stow)))
        if self._problem and not self._is_released:
            return HandOutcome(False, self._problem)
        if self.held is not None:
            return HandOutcome(True, f"holds {self.target}")
        done = "has handed over" if self.task is HandTask.HAND_OVER else "has put down"
        return HandOutcome(True, "is stowed" if self.task is HandTask.STOW else f"{done} {self.target}")

    # -- waiting -----------------------------------------------------------------------------------------

    def step(self) -> JointOrder | None:
        """Return where the joints should be now; None while it is not known where they are."""
        if self._positions is None:
            return None
        if self._clock() - self._heard_s > self.settings.stale_s:
            if self.task is not None and self.machine.state is not HandState.RECOVER:
                self._work.begin(self._carry_out("the joints are silent"))
            return None
        self._work.tell()
        if self.task is not None and self._work.result is not None:
            self._end(self._work.result)
        if self._way is None:
            self._way = self._standing()
        passed_s = self._clock() - self._way_began_s
        return JointOrder(self._way.at(passed_s), self._opening_m)

    def _end(self, outcome: HandOutcome) -> None:
        self.outcome, self.task = outcome, None
        self._work.cancel()
        self._enter(HandState.REST, outcome.text)

    def _enter(self, state: HandState, reason: str) -> None:
        """Change the state; the arm stops where it is."""
        self.machine.go(state, reason)
        self._way = self._standing() if self._positions is not None else None

    async def _until(self, is_over: Callable[[], bool]) -> bool:
        """Wait until something is over; return False if the state takes too long.

        Raises:
            Unreachable: what was held is not there any more.
        """
        while True:
            await pause()
            is_holding = self.held is not None and self.machine.state not in GIVES_AWAY
            if is_holding and self._half_m <= self.settings.empty_m:
                self.held = self._grasp = None
                raise Unreachable(f"{self.target} slipped out of the hand")
            if self.machine.is_late:
                return False
            if is_over():
                return True

    async def _move(self, way: Floats, share: float | None = None) -> None:
        """Follow a way to its end."""
        self._follow(way, self.settings.speed if share is None else share)
        await self._until(self._has_arrived)

    async def _move_hand(self, *, ahead_m: float = 0.0, up_m: float = 0.0) -> None:
        """Move the hand straight; if it cannot, the arm stays where it is."""
        goal = moved_along(self._arm.pose(self._here()), ahead_m=ahead_m, up_m=up_m)
        names = () if self.view is None else tuple(one.name for one in self.view.objects)
        with contextlib.suppress(Unreachable):
            around = self._around(0.0, (*names, ""))
            line = straight_line(self._arm, around, self._here(), goal, self._opening_m)
            self._follow(line, self.settings.line_speed)
        await self._until(self._has_arrived)

    # -- planning ------------------------------------------------------------------------------------------

    def _around(self, margin_m: float, touchable: Collection[str] = ()) -> CollisionWorld:
        """Return what the arm must not touch; without what it holds."""
        obstacles = [] if self.view is None else [self.view.table, *self.view.objects]
        held = self.held if self._opening_m == 0.0 else None
        if held is not None:
            obstacles = [one for one in obstacles if one.name != held.name]
        held_margin_m = margin_m if touchable == () else -0.006
        return CollisionWorld(
            self._arm,
            obstacles,
            margin_m=margin_m,
            held=held,
            held_margin_m=held_margin_m,
            touchable=touchable,
        )

    def _plan_to(self, goal: Floats) -> Floats:
        """Return a way around everything, as far from obstacles as the ends allow."""
        for margin_m in MARGINS_M:
            try:
                return plan(self._around(margin_m), self._here(), goal, self._chance)
            except Unreachable:
                if margin_m == MARGINS_M[-1]:
                    raise
        raise AssertionError("unreachable")

    def _choose_grasp(self, view: TableView, shape: Shape) -> None:
        """Choose a grasp that the arm reaches, from which it can lift the object."""
        free, touching = self._around(0.01), self._around(0.003, (shape.name,))
        problem = Unreachable(f"{shape.name} is too wide for the gripper")
        tried = grasps(shape, view.top_m, self._arm.shoulder, self._arm.opening_m)
        for _, grasp in zip(range(MAX_GRASPS), tried, strict=False):
            try:
                line = self._line_to(moved_along(grasp, -self.settings.back_m), grasp, free, touching)
                held = replace(shape, pose=np.linalg.inv(grasp) @ shape.pose)
                others = [view.table, *(one for one in view.objects if one is not shape)]
                lifting = CollisionWorld(self._arm, others, margin_m=0.0, held=held, held_margin_m=-0.006)
                raised = moved_along(grasp, up_m=self.settings.lift_m)
                straight_line(self._arm, lifting, line[-1], raised, 0.0)
            except Unreachable as error:
                problem = error
                continue
            self._line = line
            return
        raise problem

    def _choose_place(self, view: TableView) -> None:
        """Choose a place that the arm reaches with what it holds."""
        if self.held is None:
            raise Unreachable("there is nothing in the hand")
        free, lowering = self._around(0.01), self._around(0.003, ("",))
        size = " m x ".join(f"{side_m:.2f}" for side_m in view.table.size_m[:2])
        names = ", ".join(one.name for one in view.objects) or "nothing"
        problem = Unreachable(
            f"there is no free place on the table: it looks {size} m large, with {names} on it"
        )
        for _, pose in zip(range(MAX_GRASPS), places(view, self.held, self._arm.shoulder), strict=False):
            try:
                above = moved_along(pose, up_m=self.settings.lift_m)
                line = self._line_to(above, pose, free, lowering)
                there = replace(self.held, pose=pose @ self.held.pose)
                around = [view.table, *view.objects, there]
                leaving = CollisionWorld(self._arm, around, margin_m=0.0, touchable=(there.name,))
                straight_line(self._arm, leaving, line[-1], moved_along(pose, -self.settings.back_m))
            except Unreachable as error:
                problem = error
                continue
            self._line = line
            return
        raise problem

    def _line_to(self, begin: Floats, end: Floats, free: CollisionWorld, near: CollisionWorld) -> Floats:
        """Return a straight way of the hand between two poses."""
        aside = np.array(self.settings.stow)
        first = reach(self._arm, free, begin, aside, self._chance, GRASP_RESTARTS)
        return straight_line(self._arm, near, first, end, self._opening_m)

    # -- moving --------------------------------------------------------------------------------------------

    def _here(self) -> Floats:
        assert self._positions is not None
        return self._positions

    @property
    def _gives_away(self) -> bool:
        return self.task in (HandTask.PUT_DOWN, HandTask.HAND_OVER)

    @property
    def stands_out(self) -> bool:
        """Return whether the arm has no order, but is not stowed: then the robot must not drive."""
        return self.task is None and self._positions is not None and not self._is_stowed()

    def _is_stowed(self) -> bool:
        return float(np.abs(self._here() - np.array(self.settings.stow)).max()) < STOWED_RAD

    def _standing(self) -> Trajectory:
        self._way_began_s = self._clock()
        speed = self._arm.max_speed
        return Trajectory(self._here()[None], speed, np.full(len(speed), 1.0))

    def _follow(self, way: Floats, share: float) -> None:
        """Begin to follow a way."""
        acceleration = np.full(len(self._arm.max_speed), self.settings.acceleration_rad_per_s2 * share)
        self._way = Trajectory(way, self._arm.max_speed * share, acceleration)
        self._way_began_s = self._clock()

    def _has_arrived(self) -> bool:
        """Return whether the arm is at the end of its way.

        Raises:
            Unreachable: it does not follow.
        """
        assert self._way is not None
        passed_s = self._clock() - self._way_began_s
        lag_rad = float(np.abs(self._way.at(passed_s) - self._here()).max())
        if lag_rad > self.settings.lag_rad:
            raise Unreachable(f"the arm does not follow: a joint is {lag_rad:.2f} rad behind")
        return passed_s >= self._way.duration_s and lag_rad < ARRIVED_RAD

    def _gripper_stands(self) -> bool:
        """Return whether the gripper has not moved for a while."""
        since_s = self._clock() - self.settings.still_s
        recent = [half for stamp_s, half in self._halves if stamp_s >= since_s]
        is_long = bool(self._halves) and self._halves[0][0] < since_s and self.machine.time_in_state_s > 0.4
        return is_long and len(recent) > 2 and max(recent) - min(recent) < 0.0005

    # -- restarts ------------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what the next process needs to go on, as plain data."""
        return {
            "task": None if self.task is None else str(self.task),
            "target": self.target,
            "tries": self.tries,
            "grasp": None if self._grasp is None else _plain(self._grasp),
            "held": self.held is not None,
            "released": self._is_released,
            "problem": self._problem,
            "view": None
            if self.view is None
            else [_plain(one) for one in (self.view.table, *self.view.objects)],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` returned: find out what the hand holds, and begin the order again."""
        self.target, self.tries, self._is_released = memory["target"], memory["tries"], memory["released"]
        self._problem = memory["problem"]
        self._grasp = None if memory["grasp"] is None else _shape(memory["grasp"])
        self.held = self._grasp if memory["held"] else None
        self._opening_m = 0.0 if self._grasp is not None else self._arm.opening_m
        if memory["view"] is not None:
            table, *objects = (_shape(one) for one in memory["view"])
            self.view = TableView(-math.inf, table, tuple(objects))
        if memory["task"] is not None:
            self.task = HandTask(memory["task"])
            self._work.begin(self._carry_out("after a restart"))


def _plain(shape: Shape) -> dict[str, Any]:
    return {
        "name": shape.name,
        "size": list(shape.size_m),
        "pose": shape.pose.tolist(),
        "is_round": shape.is_round,
    }


def _shape(plain: Mapping[str, Any]) -> Shape:
    x, y, z = plain["size"]
    return Shape(plain["name"], (x, y, z), np.array(plain["pose"]), plain["is_round"])
