"""The task: find the signs, and drive to the digits in order. It decides; it does not drive.

Call `step` a few times each second and carry out what it returns.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.exploration.drivable_ground import DrivableGround
from robbie_robots.workers.numbers.mission_states import TIME_OUTS, TRANSITIONS, NumbersSettings, NumbersState
from robbie_robots.workers.numbers.mission_targets import (
    Look,
    NumbersTarget,
    NumbersTargets,
    PostWish,
    SignReport,
    aside_of,
)
from robbie_robots.workers.numbers.sign_map import ALL_SECTORS, SECTORS, sector_rad

Points = NDArray[np.float64]

ASCENDING = tuple(range(10))
TRAVELS = frozenset({NumbersState.EXPLORE, NumbersState.SEARCH, NumbersState.APPROACH})
STANDS = frozenset({NumbersState.WAIT, NumbersState.HALT})
MAX_ATTEMPTS = 4
"""Number of places in front of a sign that the robot tries before it returns to the first one."""
MOVED_M, TURNED_RAD = 0.3, 0.2
"""A goal in front of a sign stays the same until the sign turns out to stand or face differently by this."""
LOOK_M = (1.5, 3.4)
"""On its way, the robot looks at posts between these distances."""
WANTED_WORTH, OTHER_WORTH = 15.0, 1.0
"""A post is worth this if it seems to carry the next number, or another digit; otherwise it is worth 1."""
CONFIRM_RAD = 0.9
"""A digit that is not sure is looked at from this far to both sides of its front."""
KEEP_SHARE = 0.6
"""The robot drives on to where it wanted to look from, until another place is worth much more."""
LEAST_VIEW_S = 1.0
MAX_AVOIDED = 12
EMPTY_PLANS = 3
"""Number of maps in a row without anything left to search that end a search. One map may be incomplete."""


@dataclass(frozen=True)
class NumbersOrder:
    """The robot's current order.

    Attributes:
        goal: `(3,)`, x, y (m) and heading (rad), map frame. None: stand still.
        look_at_xy_m: m, map frame. None: look around.
    """

    goal: Points | None = None
    look_at_xy_m: tuple[float, float] | None = None


class NumbersMission:
    """Carries out the task once.

    Args:
        clock: Returns the time in s.
        settings: How to carry it out.
        on_change: Called with each new state.

    Attributes:
        machine: The state machine, and why it entered the current state.
        order: The digits in the order of the visits; empty before it is known.
        reached: The digits that were reached, in this order.
        signs: All posts and signs.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        settings: NumbersSettings | None = None,
        on_change: Callable[[NumbersState], None] = lambda _state: None,
    ) -> None:
        self.settings = settings or NumbersSettings()
        self.machine = StateMachine(NumbersState.WAIT, TRANSITIONS, clock, TIME_OUTS, on_change)
        self.order: tuple[int, ...] = ()
        self.reached: list[int] = []
        self.signs: list[SignReport] = []
        self._clock = clock
        self._began_s = clock()
        self._ground: DrivableGround | None = None
        self._pose: Points | None = None
        self._stopped: str | None = "navigation does not report"
        self._sheet = ""
        self._images: int | None = None
        self._first_image: int | None = None
        self._target: NumbersTarget | None = None
        self._planned_s = -math.inf
        self._given_up: list[tuple[float, float]] = []
        self._looked: list[Look] = []
        self._look = 0
        self._avoided: list[Points] = []
        self._avoided_views: list[Points] = []
        self._round = 0
        self._empty_plans = 0

    @property
    def state(self) -> NumbersState:
        """Return what the robot does."""
        return self.machine.state

    @property
    def used_s(self) -> float:
        """Return how long the task has taken so far."""
        return self._clock() - self._began_s

    @property
    def wanted(self) -> int | None:
        """Return the next digit; None if all were reached, or the order is not known."""
        return self.order[len(self.reached)] if len(self.reached) < len(self.order) else None

    @property
    def status(self) -> str:
        """Return what the robot does, why, and what it has reached, in one line."""
        known = "".join(sorted(str(sign.digit) for sign in self.signs if sign.digit is not None))
        reached = "".join(map(str, self.reached)) or "none"
        wanted = "" if self.wanted is None else f", next {self.wanted}"
        return f"{self.state} ({self.machine.reason}); reached {reached}{wanted}; sees {known or 'none'}"

    # -- inputs ----------------------------------------------------------------------------------------

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        """Take a new map. `DrivableGround` describes the arguments."""
        self._ground = DrivableGround(cells, resolution_m, corner_xy_m, self.settings)

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._pose = np.asarray(pose, float)

    def see_signs(self, signs: Sequence[SignReport], sheet: str, images: int) -> None:
        """Take what is known about signs.

        Args:
            signs: all posts and signs.
            sheet: the order on a sheet; '' if none was read.
            images: how many images were searched for signs so far.
        """
        self.signs = list(signs)
        self._sheet, self._images = sheet, images

    def see_stopped(self, reason: str | None) -> None:
        """Record why the robot cannot drive. None: it can."""
        self._stopped = reason

    def arrived(self) -> None:
        """Record that the robot has reached its latest goal."""
        target, self._planned_s = self._target, -math.inf
        if target is None or self.state not in TRAVELS:
            return
        if self.state is NumbersState.SEARCH:
            self._look = 0
            self.machine.go(NumbersState.VIEW, _place_text(target.about_xy_m))
        elif self.state is NumbersState.EXPLORE:
            self._give_up("is there")
        else:
            self._judge_approach(target)

    def unreachable(self, reason: str) -> None:
        """Record that the robot cannot reach its latest goal."""
        if self.state in TRAVELS:
            self._give_up(reason)

    # -- outputs ---------------------------------------------------------------------------------------

    def step(self) -> NumbersOrder:
        """Decide what the robot does now, and return it."""
        if self.machine.is_final:
            return NumbersOrder()
        if self.used_s >= self.settings.time_limit_s:
            self.machine.go(NumbersState.DONE, "the time is over")
        elif self._ground is not None and self._pose is not None and self._images is not None:
            self._judge()
        return self._orders()

    def _judge(self) -> None:
        """Change the state if an input or the time requires it."""
        state = self.state
        if self.order and self.wanted is None and state is not NumbersState.REACHED:
            self.machine.go(NumbersState.DONE, "has reached all numbers")
        elif self._stopped is not None:
            if state not in STANDS:
                self._target = None
                self.machine.go(NumbersState.HALT, self._stopped)
        elif state in STANDS:
            self.machine.go(NumbersState.LOOK if self.order else NumbersState.SHEET, "it can drive")
        elif state is NumbersState.SHEET:
            self._judge_sheet()
        elif state is NumbersState.REACHED and self.wanted is None:
            if self.machine.time_in_state_s >= TIME_OUTS[state].after_s:
                self.machine.go(NumbersState.DONE, "has reached all numbers")
        elif state is NumbersState.VIEW:
            self._judge_view()
        elif self.machine.expire():
            self._target = None
            self._plan()
        elif state in TRAVELS:
            if self.machine.time_in_state_s > self.settings.travel_s:
                self._give_up("that took too long")
            if self._clock() - self._planned_s >= self.settings.plan_period_s:
                self._plan()

    def _judge_sheet(self) -> None:
        """Take the order from the sheet, or ascending if enough images have shown none."""
        assert self._images is not None
        if self._first_image is None:
            self._first_image = self._images
        if self._sheet:
            self.order = tuple(int(digit) for digit in self._sheet)
            self.machine.go(NumbersState.LOOK, f"the sheet says {self._sheet}")
        elif self._images - self._first_image >= self.settings.sheet_images:
            self.order = ASCENDING
            self.machine.go(NumbersState.LOOK, "there is no sheet: ascending order")

    def _judge_view(self) -> None:
        """End a look after its time, or when it is known what the post carries; then look at the next one."""
        assert self._target is not None
        looks = self._target.looks
        look = looks[self._look]
        passed_s = self.machine.time_in_state_s
        is_over = passed_s >= TIME_OUTS[NumbersState.VIEW].after_s
        is_left = any(self._wish(sign).seen_from(look.from_xy_m) for sign in self._signs_at(look.xy_m))
        if not is_over and (is_left or passed_s < LEAST_VIEW_S):
            return
        self._looked.append(look)
        self._look += 1
        if self._look < len(looks):
            self.machine.go(NumbersState.VIEW, _place_text(looks[self._look].xy_m))
            return
        self._target = None
        self.machine.go(NumbersState.EXPLORE, "has looked")
        self._plan()

    def _signs_at(self, xy_m: tuple[float, float]) -> list[SignReport]:
        return [sign for sign in self.signs if math.dist(sign.xy_m, xy_m) <= MOVED_M]

    def _plan(self) -> None:
        """Choose what to do next."""
        assert self._ground is not None
        assert self._pose is not None
        self._planned_s = self._clock()
        if self._is_on_its_way():
            return
        targets = NumbersTargets(self._ground, self._pose, self.settings)
        if not targets.can_drive:
            return
        target = self._wanted_front(targets) or self._best_search(targets)
        if target is not None:
            self._empty_plans = 0
            self._take(target)
            return
        self._empty_plans += 1
        if self._empty_plans >= EMPTY_PLANS:
            self._begin_round()

    def _is_on_its_way(self) -> bool:
        """Return whether the robot drives to the surest sign with the wanted digit and may stop there."""
        target, carriers = self._target, self._carriers()
        if self.state is not NumbersState.APPROACH or target is None or not carriers:
            return False
        is_near = math.dist(target.about_xy_m, carriers[0].xy_m) <= MOVED_M / 2
        return is_near and self._is_allowed(target)

    def _wanted_front(self, targets: NumbersTargets) -> NumbersTarget | None:
        """Return where to stop in front of the wanted digit, if its place is known."""
        for sign in self._carriers():
            target = targets.front_of(sign, self._avoided)
            if target is not None:
                return target
        return None

    def _carriers(self) -> list[SignReport]:
        """Return the signs that carry the wanted digit, the surest first.

        After a round in vain, also those on which it was read, but not surely: there, the robot may be right.
        """
        if self.wanted is None:
            return []
        sure = [sign for sign in self.signs if sign.digit == self.wanted]
        if not sure and self._round:
            sure = [sign for sign in self.signs if sign.is_open and sign.likely == self.wanted]
        return sorted(sure, key=lambda sign: -sign.views)

    def _best_search(self, targets: NumbersTargets) -> NumbersTarget | None:
        """Return the best place to search; the current target as long as it is worth almost as much."""
        wishes = [wish for sign in self.signs if (wish := self._wish(sign)).bits]
        between_m = self.settings.again_m if self._round else self.settings.view_m
        view = targets.best_view(wishes, between_m, self._avoided_views)
        found = [] if view is None else [view]
        found += [target for target in targets.frontiers() if not self._is_given_up(target)]
        best = max(found, key=lambda target: target.value, default=None)
        old = self._target
        if best is None or old is None:
            return best
        if old.state is NumbersState.SEARCH:
            again = targets.view_again(old, wishes, between_m)
        else:
            again = next((target for target in found if target.is_like(old)), None)
        return again if again is not None and again.value >= KEEP_SHARE * best.value else best

    def _wish(self, sign: SignReport) -> PostWish:
        """Return what the robot wants to see of a post in this round."""
        is_closed = sign.digit is not None or not (sign.is_open or self._round)
        bits = 0 if is_closed else ALL_SECTORS
        if sign.likely is None or math.isnan(sign.facing_rad):
            wish = PostWish(sign.xy_m, bits if self._round else bits & ~sign.searched)
        else:
            for number in range(SECTORS):
                if abs(math.remainder(sector_rad(number) - sign.facing_rad, math.tau)) > CONFIRM_RAD:
                    bits &= ~(1 << number)
            worth = WANTED_WORTH if sign.likely == self.wanted else OTHER_WORTH
            wish = PostWish(sign.xy_m, bits, worth, sign.facing_rad)
        # A look that found the digit covers less of the wish to make sure of it than of the search before.
        for look in self._looked:
            if math.dist(look.xy_m, sign.xy_m) <= MOVED_M:
                wish = replace(wish, bits=wish.bits & ~wish.seen_from(look.from_xy_m))
        return wish

    def _take(self, target: NumbersTarget) -> None:
        """Take a target, unless it is almost the current one: each new goal restarts navigation."""
        old = self._target
        if target.state is NumbersState.SEARCH:
            self._target = target
            if old is None or self.state is not target.state or not np.array_equal(old.goal, target.goal):
                self.machine.go(target.state, _place_text(target.about_xy_m))
            return
        if old is not None and self.state is target.state and old.is_like(target):
            if target.state is not NumbersState.APPROACH:
                return
            if math.dist(old.about_xy_m, target.about_xy_m) <= MOVED_M / 2 and self._is_allowed(old):
                return
        self._target = target
        about = _place_text(target.about_xy_m)
        is_wanted = target.state is NumbersState.APPROACH
        self.machine.go(target.state, f"number {self.wanted} {about}" if is_wanted else about)

    def _is_allowed(self, target: NumbersTarget) -> bool:
        is_new = all(math.dist(target.goal[:2], place[:2]) > MOVED_M / 2 for place in self._avoided)
        return is_new and self._is_in_front(target.goal, target.about_xy_m)

    def _is_in_front(self, place: Points, sign_xy_m: tuple[float, float]) -> bool:
        """Return whether a place is in front of the wanted sign, as far as is known which way it faces."""
        signs = [sign for sign in self._carriers() if math.dist(sign.xy_m, sign_xy_m) <= MOVED_M]
        most_rad = self.settings.stop_rad + TURNED_RAD
        return all(aside_of(sign, place[None, :2])[0] <= most_rad for sign in signs)

    def _begin_round(self) -> None:
        """Look at all posts again, or give up."""
        self._round, self._empty_plans = self._round + 1, 0
        self._given_up, self._looked, self._avoided, self._avoided_views = [], [], [], []
        if self._round > self.settings.max_rounds:
            self.machine.go(NumbersState.DONE, f"did not find a way to number {self.wanted}")

    def _judge_approach(self, target: NumbersTarget) -> None:
        """Say that the number is reached, if the robot is near it."""
        assert self._pose is not None
        away_m = math.dist(self._pose[:2], target.about_xy_m)
        if self.wanted is None or away_m > self.settings.reached_m:
            self._give_up(f"{away_m:.1f} m away")
            return
        if not self._is_in_front(self._pose, target.about_xy_m):
            self._give_up("not in front of the board")
            return
        digit = self.wanted
        self.reached.append(digit)
        self._avoided, self._avoided_views, self._looked, self._round = [], [], [], 0
        self.machine.go(NumbersState.REACHED, f"number {digit} is {away_m:.2f} m away")

    def _give_up(self, reason: str) -> None:
        """Exclude the current target and plan again."""
        if self._target is not None:
            if self.state is NumbersState.APPROACH:
                self._avoided = [*self._avoided, self._target.goal][-MAX_ATTEMPTS:]
            elif self.state is NumbersState.SEARCH:
                self._avoided_views = [*self._avoided_views, self._target.goal][-MAX_AVOIDED:]
            else:
                self._given_up.append(self._target.about_xy_m)
        self._target = None
        self._planned_s = -math.inf
        self.machine.go(NumbersState.EXPLORE, reason)

    def _is_given_up(self, target: NumbersTarget) -> bool:
        return any(math.dist(place, target.about_xy_m) <= MOVED_M for place in self._given_up)

    def _orders(self) -> NumbersOrder:
        if self._target is None:
            return NumbersOrder()
        if self.state is NumbersState.VIEW:
            return NumbersOrder(None, self._target.looks[self._look].xy_m)
        if self.state is NumbersState.REACHED:
            return NumbersOrder(None, self._target.about_xy_m)
        return NumbersOrder(self._target.goal if self.state in TRAVELS else None, self._worth_a_look())

    def _worth_a_look(self) -> tuple[float, float] | None:
        """Return the nearest post near the way of which the robot sees something that it wants to see."""
        if self._pose is None:
            return None
        near: list[tuple[float, tuple[float, float]]] = []
        for sign in self.signs:
            wish, away_m = self._wish(sign), math.dist(self._pose[:2], sign.xy_m)
            if LOOK_M[0] <= away_m <= LOOK_M[1] and wish.seen_from(self._pose.tolist()):
                near.append((away_m / wish.worth, sign.xy_m))
        return min(near)[1] if near else None

    # -- restarts --------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what a restarted mission needs to go on, as plain data."""
        return {
            "over": self.machine.reason if self.machine.is_final else None,
            "used_s": self.used_s,
            "order": list(self.order),
            "reached": list(self.reached),
            "given_up": [list(one) for one in self._given_up],
            "looked": [[*look.xy_m, *look.from_xy_m] for look in self._looked],
            "round": self._round,
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Continue from the data that `memory` returned."""
        self._began_s = self._clock() - memory["used_s"]
        self.order = tuple(memory["order"])
        self.reached = list(memory["reached"])
        self._given_up = [(x, y) for x, y in memory["given_up"]]
        self._looked = [Look((x, y), (from_x, from_y)) for x, y, from_x, from_y in memory["looked"]]
        self._round = memory["round"]
        if memory["over"] is not None:
            self.machine.go(NumbersState.DONE, memory["over"])


def _place_text(xy_m: tuple[float, float]) -> str:
    return f"at {xy_m[0]:.1f}, {xy_m[1]:.1f}"
