"""Carries out the orders of a household, one task after another. It decides; it does not drive or grasp.

Call `step` a few times each second, and do what `goal`, `arm_task`, `lesson`, `follows` and `asks_who` say.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.household_states import (
    ARM_WORKS,
    DRIVES,
    TRANSITIONS,
    WAYS,
    HouseholdSettings,
    HouseholdState,
)
from robbie_robots.workers.home.orders import NEEDS_ARM, Task, TaskOrder, WrongOrder, check_orders

Array = NDArray[np.float64]

MAX_SAYINGS = 8
MAX_ENDS = 100
MAX_GIVERS = 8
TAKE_IT = "Here is the {}. Please take it."
COME = "I have the {}. Please come to me."
STILL_HERE_M = 0.5
"""Until the robot has driven this far, it looks for the person who has given the order."""
OPEN_DOOR = "Please open the door to the {}."


@dataclass(frozen=True)
class TaskEnd:
    """How a task ended.

    Attributes:
        order: the task.
        is_done: whether the robot has done it.
        reason: why it ended, in plain words.
        duration_s: how long it took.
    """

    order: TaskOrder
    is_done: bool
    reason: str
    duration_s: float


class _Giver(NamedTuple):
    """Somebody who may have given the order; the likeliest is the least."""

    has_one_leg: bool
    is_aside: bool
    away_m: float
    xy_m: tuple[float, float]


class HouseholdWork:
    """Carries out one order at a time, which has one or several tasks.

    Its owner drives to `goal`, has the arm do `arm_task`, keeps the place of `lesson`, follows while
    `follows`, and looks for persons while `asks_who`; and it says how each ends.

    Args:
        clock: Returns the time in s.
        tables: Names of the places in front of tables on which it looks for objects.
        settings: How it carries out orders.
        on_change: Called with each new state.

    Attributes:
        machine: Its state, and why it entered it.
        orders: The tasks of the present order; empty if there is none.
        at: The place of the present task among them.
        has_arm: Whether there is an arm that works.
        holds: What is in the hand; '' if nothing is.
        seen: For each object the table on which it was seen last.
        places: x, y (m) and heading (rad) of each place that it knows, map frame.
        doors: The same, in front of the door to each place that has one.
        ends: How the last tasks ended.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        tables: Sequence[str] = (),
        settings: HouseholdSettings | None = None,
        on_change: Callable[[HouseholdState], None] = lambda _state: None,
    ) -> None:
        self.settings = settings or HouseholdSettings()
        self.machine = StateMachine(
            HouseholdState.IDLE, TRANSITIONS, clock, self.settings.time_outs(), on_change
        )
        self.orders: tuple[TaskOrder, ...] = ()
        self.at = 0
        self.has_arm = False
        self._hand_holds = ""
        self.holds = ""
        self.seen: dict[str, str] = {}
        self.places: Mapping[str, tuple[float, float, float]] = {}
        self.doors: Mapping[str, Sequence[float]] = {}
        self.ends: deque[TaskEnd] = deque(maxlen=MAX_ENDS)
        self._clock = clock
        self._tables = tuple(tables)
        self._pose: Array | None = None
        self._given_at: Array | None = None
        self._givers: dict[str, _Giver] = {}
        self._is_where_given = False
        self._persons: list[PersonReport] = []
        self._things: list[PersonReport] = []
        self._sayings: deque[str] = deque(maxlen=MAX_SAYINGS)
        self._began_s = clock()
        self._renew()

    def _renew(self) -> None:
        """Forget what belongs to the last task."""
        self._table = ""
        self._to_search: list[str] = []
        self._rounds = self._tries = self._losses = self._failed_drives = 0
        self._meeting: tuple[Array, Array] | None = None
        self._taker_xy_m: Array | None = None
        self._refusals: list[Array] = []
        self._is_near_person = self._has_called = False
        self._requests = 0
        self._behind = HouseholdState.GO
        self._at_door_s = math.inf
        self._ahead_m = 0.0

    # -- what the owner does -----------------------------------------------------------------------------

    @property
    def state(self) -> HouseholdState:
        """Return what the robot does."""
        return self.machine.state

    @property
    def order(self) -> TaskOrder | None:
        """Return the present task; None if there is none."""
        return self.orders[self.at] if self.orders else None

    @property
    def goal(self) -> Array | None:
        """Return where the robot should be: (3,), x, y (m) and heading (rad), map frame. None: it stands."""
        order = self.order
        if self.state is HouseholdState.MEET:
            return self._meeting[0] if self._meeting is not None else None
        if self.state is HouseholdState.DOOR:
            return np.array(self.doors[self._destination])
        if order is None or self.state not in DRIVES:
            return None
        if self.state is HouseholdState.FETCH:
            return self._place(self._table)
        return self._place(order.place) if order.place else self._given_at

    @property
    def _destination(self) -> str:
        """Return the name of the place to which the present task leads now; '' if it has none."""
        drive = self._behind if self.state is HouseholdState.DOOR else self.state
        return self._table if drive is HouseholdState.FETCH or self.order is None else self.order.place

    @property
    def arm_task(self) -> HouseholdState | None:
        """Return PICK, PUT or HAND while the arm should work."""
        return self.state if self.state in ARM_WORKS else None

    @property
    def lesson(self) -> tuple[str, Array] | None:
        """Return the name of the place that is to be kept, and where it is; None if there is none."""
        order = self.order
        if self.state is not HouseholdState.LEARN or order is None or self._pose is None:
            return None
        return order.place, self._pose

    @property
    def follows(self) -> bool:
        """Return whether the robot should follow a person."""
        return self.state is HouseholdState.FOLLOW

    @property
    def asks_who(self) -> bool:
        """Return whether the robot should find out who is where."""
        return self.state is HouseholdState.WHO

    @property
    def status(self) -> str:
        """Return what the robot does, and why, in one line."""
        done = sum(end.is_done for end in self.ends)
        what = "no order" if self.order is None else self.order.text
        held = f"; holds {self.holds}" if self.holds else ""
        return (
            f"{what}: {self.state} ({self.machine.reason}){held}; {done} done, {len(self.ends) - done} failed"
        )

    def sayings(self) -> list[str]:
        """Return what the robot has to say, and forget it."""
        said = list(self._sayings)
        self._sayings.clear()
        return said

    # -- orders ------------------------------------------------------------------------------------------

    def begin(self, orders: Sequence[TaskOrder]) -> None:
        """Carry out an order; one that is under way ends.

        Raises:
            WrongOrder: the robot cannot begin it; the one under way goes on.
        """
        if not self.has_arm and any(order.task in NEEDS_ARM for order in orders):
            raise WrongOrder("I have no arm that I can use")
        check_orders(orders, self.places, self.holds)
        self.cancel("another order has come")
        self.orders, self.at = tuple(orders), 0
        self._order_is_given_here()
        self._begin_task()

    def _order_is_given_here(self) -> None:
        """Note where the robot is, and where those stand to whom it may bring things."""
        self._given_at = None if self._pose is None else self._pose.copy()
        self._givers, self._is_where_given = {}, True
        self._note_givers()

    def _note_givers(self) -> None:
        """Note where the persons stand who may have given the order: the one in front, or else the nearest.

        Corners of furniture look like one leg, so they come last.

        Persons need a moment to be noticed, so the robot goes on with it until it has driven away.
        """
        if not self._is_where_given or self._pose is None or self._given_at is None:
            return
        x, y, heading = self._given_at.tolist()
        self._is_where_given = math.dist(self._pose[:2], (x, y)) <= STILL_HERE_M
        for one in self._fresh(self._persons) if self._is_where_given else ():
            away_m = math.dist(one.xy_m, (x, y))
            bearing = math.atan2(one.xy_m[1] - y, one.xy_m[0] - x)
            is_aside = abs(math.remainder(bearing - heading, math.tau)) > self.settings.front_rad
            if away_m <= self.settings.person_m and (
                one.name in self._givers or len(self._givers) < MAX_GIVERS
            ):
                has_one_leg = one.two_legs < self.settings.two_legs
                self._givers[one.name] = _Giver(has_one_leg, is_aside, away_m, one.xy_m)

    def _likely_givers(self) -> list[Array]:
        """Return where those stand who may have given the order and have not refused, the likeliest first."""
        places = [np.array(giver.xy_m) for giver in sorted(self._givers.values())]
        return [xy_m for xy_m in places if not self._has_refused(xy_m)]

    def _fresh(self, persons: Iterable[PersonReport]) -> list[PersonReport]:
        return [one for one in persons if one.unseen_s <= self.settings.fresh_s]

    def cancel(self, reason: str) -> bool:
        """End the order; the robot stands, and holds what it holds. Return whether there was one."""
        if not self.orders:
            return False
        self._end(False, reason, says=False)
        return True

    def _begin_task(self) -> None:
        order = self.orders[self.at]
        self._renew()
        self._began_s = self._clock()
        if order.task is not Task.LEARN:
            self._sayings.append(f"I {order.text}.")
        match order.task:
            case Task.GO:
                self.machine.go(HouseholdState.GO, order.text)
            case Task.LEARN:
                self.machine.go(HouseholdState.LEARN, order.text)
            case Task.FOLLOW:
                self.machine.go(HouseholdState.FOLLOW, order.text)
            case Task.WHO:
                self.machine.go(HouseholdState.WHO, order.text)
            case Task.BRING | Task.PUT if self.holds and order.object in ("", self.holds):
                self.machine.go(HouseholdState.CARRY, f"holds {self.holds}")
            case Task.BRING | Task.PUT if order.object:
                self._search("")
            case Task.BRING | Task.PUT:
                self._end(False, "there is nothing in the hand")

    def _end(self, is_done: bool, reason: str, *, says: bool = True) -> None:
        """End the task; after a success, begin the next one."""
        order = self.orders[self.at]
        self.ends.append(TaskEnd(order, is_done, reason, self._clock() - self._began_s))
        if self.state is not HouseholdState.IDLE:
            self.machine.go(HouseholdState.IDLE, reason)
        if not is_done and self.has_arm:
            self.holds = self._hand_holds
        if not is_done and says:
            self._sayings.append(f"I could not {order.text}: {reason}.")
        if is_done and self.at + 1 < len(self.orders):
            self.at += 1
            self._begin_task()
        else:
            self.orders, self.at = (), 0

    # -- inputs ------------------------------------------------------------------------------------------

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._pose = np.asarray(pose, float)
        if self._given_at is None and self.orders:
            self._order_is_given_here()
        self._note_givers()

    def see_persons(self, persons: Iterable[PersonReport]) -> None:
        """Take all persons that are tracked now."""
        self._persons = list(persons)
        self._note_givers()

    def see_things(self, things: Iterable[PersonReport]) -> None:
        """Take what looks like the legs of standing persons, but is on the map: it may be furniture."""
        self._things = list(things)

    def see_hand(self, holds: str) -> None:
        """Take what the arm says that it holds; without an order, others may have used it."""
        self.has_arm, self._hand_holds = True, holds
        if not self.orders:
            self.holds = holds

    def see_objects(self, names: Iterable[str]) -> None:
        """Take what stands on the table in front of the robot."""
        if self.state is HouseholdState.PICK:
            self.seen.update(dict.fromkeys(names, self._table))

    def arrived(self) -> None:
        """Record that navigation has reached the goal; in front of a table, the pose must be right."""
        if self.state is HouseholdState.MEET:
            self._is_near_person = True
        elif self.state is HouseholdState.DOOR:
            self._arrived_at_door()
        elif self.state is HouseholdState.GO:
            self._end(True, "there")
        elif self.state in DRIVES and self._is_at(self.goal):
            self._failed_drives = 0
            if self.state is HouseholdState.FETCH:
                if (order := self.order) is not None:
                    self.seen.pop(order.object, None)
                self.machine.go(HouseholdState.PICK, f"in front of the {self._table}")
            elif (order := self.order) is not None and order.task is Task.PUT:
                self.machine.go(HouseholdState.PUT, f"in front of the {order.place}")
            else:
                self.machine.go(HouseholdState.MEET, "where the order was given")

    def unreachable(self, reason: str) -> None:
        """Record that navigation has given the goal up; the owner sends it again."""
        if self.state is HouseholdState.MEET:
            self._is_near_person = True
        elif self.state is HouseholdState.DOOR:
            self._requests = self.settings.max_requests
            self._drive_on(f"cannot come to the door: {reason}")
        elif self.state in DRIVES:
            if self._destination in self.doors and self._requests < self.settings.max_requests:
                self._behind = self.state
                self.machine.go(HouseholdState.DOOR, f"cannot come to the {self._destination}: {reason}")
                return
            self._failed_drives += 1
            if self._failed_drives < self.settings.max_tries:
                return
            if self.state is HouseholdState.FETCH:
                self._search(f"cannot come to the {self._table}: {reason}")
            else:
                self._end(False, reason)

    def arm_done(self) -> None:
        """Record that the arm has done its task."""
        order = self.order
        if order is None:
            return
        if self.state is HouseholdState.PICK:
            self.holds, self._tries = order.object, 0
            self.seen.pop(order.object, None)
            self.machine.go(HouseholdState.CARRY, f"holds {self.holds}")
        elif self.state is HouseholdState.PUT:
            if self.holds:
                self.seen[self.holds] = order.place
            self.holds = ""
            self._end(True, f"it is on the {order.place}")
        elif self.state is HouseholdState.HAND:
            self.holds = ""
            self._end(True, "handed over")

    def arm_failed(self, reason: str, is_refused: bool = False) -> None:
        """Record that the arm could not do its task.

        Args:
            reason: why, in plain words.
            is_refused: whether it did not even begin, because the hand is not what the robot took it for.
        """
        order = self.order
        if order is None or self.state not in ARM_WORKS:
            return
        if self.state is HouseholdState.PICK:
            self._tries += 1
            is_here = self.seen.get(order.object) == self._table
            if is_here and self._tries < self.settings.max_tries:
                self.machine.go(HouseholdState.FETCH, f"once more: {reason}")
            else:
                self._search(reason)
        elif is_refused:
            self.holds = ""
            self._losses += 1
            if order.object and self._losses < self.settings.max_tries:
                self._search(reason)
            else:
                self._end(False, reason)
        else:
            self._tries += 1
            again = HouseholdState.CARRY if self.state is HouseholdState.PUT else HouseholdState.MEET
            if self._taker_xy_m is not None:
                self._refusals.append(self._taker_xy_m)
                self._meeting = self._taker_xy_m = None
            if self._tries < self.settings.max_tries:
                self.machine.go(again, f"once more: {reason}")
            else:
                self._end(False, reason)

    def learnt(self, error: str = "") -> None:
        """Record that the place has its name, or why not."""
        order = self.order
        if self.state is HouseholdState.LEARN and order is not None:
            if not error:
                self._sayings.append(f"This is the {order.place}.")
            self._end(not error, error or "has its name")

    def follow_ended(self, is_done: bool, reason: str) -> None:
        """Record that the robot follows nobody any more."""
        if self.state is HouseholdState.FOLLOW:
            self._order_is_given_here()  # the person is here now
            self._end(is_done, reason, says=False)  # the one that follows has said why

    def who_ended(self, is_done: bool, reason: str) -> None:
        """Record that the robot has found out who is where, or why not."""
        if self.state is HouseholdState.WHO:
            self._end(is_done, reason, says=False)  # the one that looks has said it

    def step(self) -> None:
        """End what takes too long; find a person who takes what the robot brings."""
        state = self.state
        if self.machine.expire():
            self._end(False, f"{state.value}: that took too long")
        elif state is HouseholdState.MEET:
            self._meet()
        elif state is HouseholdState.DOOR and self._at_door_s < math.inf:
            self._watch_door()

    # -- doors -------------------------------------------------------------------------------------------

    def see_ahead(self, range_m: float) -> None:
        """Take how far the laser sees straight ahead; so the robot notices that a door is open."""
        self._ahead_m = range_m

    def _watch_door(self) -> None:
        """Drive on if the door is open, and ask again if it is not for too long.

        Only a step does this: its owner then sends the new goal at once, so the end of the old one, at the
        door, does not count for the new one.
        """
        if self._ahead_m >= self.settings.open_m:
            self._drive_on("the door is open")
        elif self._clock() - self._at_door_s >= self.settings.door_s:
            self._at_door_s = math.inf
            self._arrived_at_door()

    def _arrived_at_door(self) -> None:
        """Ask for the door, and wait."""
        if self._at_door_s == math.inf and self._requests < self.settings.max_requests:
            self._requests += 1
            self._at_door_s, self._ahead_m = self._clock(), 0.0
            self._sayings.append(OPEN_DOOR.format(self._destination))
        elif self._at_door_s == math.inf:
            self._drive_on("nobody has opened the door")

    def _drive_on(self, reason: str) -> None:
        """Drive to where the door leads."""
        self._at_door_s = math.inf
        self.machine.go(self._behind, reason)

    # -- objects and persons -----------------------------------------------------------------------------

    def _search(self, reason: str) -> None:
        """Drive to the next table on which the object may be."""
        order = self.orders[self.at]
        if not self._to_search and self._rounds < self.settings.rounds:
            self._rounds += 1
            known = [name for name in self._tables if name in self.places]
            last = self.seen.get(order.object)
            self._to_search = sorted(known, key=lambda name: (name != last, self._way_m(name)))
        if not self._to_search:
            self._end(False, reason or "I know no table")
            return
        self._table = self._to_search.pop(0)
        self._tries = self._failed_drives = 0
        if self.state is not HouseholdState.FETCH:
            self.machine.go(HouseholdState.FETCH, f"looks on the {self._table}")

    def _way_m(self, name: str) -> float:
        place = self._place(name)
        return math.inf if place is None or self._pose is None else math.dist(place[:2], self._pose[:2])

    def _place(self, name: str) -> Array | None:
        return np.array(self.places[name]) if name in self.places else None

    def _is_at(self, goal: Array | None) -> bool:
        """Return whether the robot stands right for its arm; anywhere near will do for a person."""
        order = self.order
        if goal is None or self._pose is None or order is None:
            return False
        if self.state is HouseholdState.CARRY and order.task is Task.BRING:
            return True
        turned_rad = math.remainder(float(goal[2] - self._pose[2]), math.tau)
        near = math.dist(goal[:2], self._pose[:2]) <= self.settings.at_table_m
        return near and abs(turned_rad) <= self.settings.at_table_rad

    def _meet(self) -> None:
        """Come to the person who gave the order, or else to the nearest one, and then hand over."""
        if self._pose is None:
            return
        waits = self.machine.time_in_state_s < self.settings.wait_s
        xy_m = self._taker(waits)
        if xy_m is None:
            if self._meeting is None and (givers := self._likely_givers()):
                self._come_to(givers[0])  # the person may be hidden from here
            if not waits and not self._has_called:
                self._has_called = True
                self._sayings.append(COME.format(self.holds))
            return
        away_m, bearing = self._direction(xy_m)
        aside_rad = abs(math.remainder(bearing - float(self._pose[2]), math.tau))
        limit_m = self.settings.far_m if self._is_near_person else self.settings.near_m
        has_moved = self._meeting is None or math.dist(self._meeting[1], xy_m) > self.settings.moved_m
        if away_m <= limit_m and aside_rad <= self.settings.ahead_rad:
            self._sayings.append(TAKE_IT.format(self.holds))
            self._taker_xy_m = xy_m
            self.machine.go(HouseholdState.HAND, f"a person is {away_m:.1f} m away")
        elif has_moved or self._is_near_person:
            self._come_to(xy_m)

    def _taker(self, waits: bool) -> Array | None:
        """Return where the person is who should take what the robot brings; None if nobody is seen.

        Args:
            waits: whether only the person who gave the order may take it, if the robot has seen that person.
        """
        assert self._pose is not None
        persons, things = (
            [xy_m for one in self._fresh(seen) if not self._has_refused(xy_m := np.asarray(one.xy_m))]
            for seen in (self._persons, self._things)
        )
        settings = self.settings
        givers = self._likely_givers()
        for giver in givers:
            # Near by, the legs of somebody who stands get on the map as those of furniture do. But here the
            # robot has seen a person before.
            for places, within_m in ((persons, settings.same_m), (things, settings.thing_m)):
                away = [(math.dist(place, giver), tuple(place)) for place in places]
                if away and min(away)[0] <= within_m:
                    return np.array(min(away)[1])
        if givers and waits:
            return None
        away = [(self._direction(place)[0], tuple(place)) for place in persons]
        return np.array(min(away)[1]) if away and min(away)[0] <= settings.person_m else None

    def _has_refused(self, xy_m: Array) -> bool:
        """Return whether nobody there has taken the object: what looked like legs may be furniture."""
        return any(math.dist(place, xy_m) <= self.settings.refused_m for place in self._refusals)

    def _direction(self, xy_m: Array) -> tuple[float, float]:
        """Return how far away a place is, m, and its bearing, rad, map frame."""
        assert self._pose is not None
        x, y = (xy_m - self._pose[:2]).tolist()
        return math.hypot(x, y), math.atan2(y, x)

    def _come_to(self, xy_m: Array) -> None:
        """Drive to the place before a person; only turn if that is near enough, or nearer is not possible."""
        assert self._pose is not None
        away_m, bearing = self._direction(xy_m)
        before_m = self.settings.before_m
        before = xy_m - before_m * np.array([math.cos(bearing), math.sin(bearing)])
        if away_m <= (self.settings.far_m if self._is_near_person else before_m):
            before = self._pose[:2]
        self._meeting = np.array([*before, bearing]), xy_m
        self._is_near_person = False

    # -- restarts ----------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what the next process needs to go on, as plain data."""
        return {
            "state": self.state.name,
            "orders": [_plain(one) for one in self.orders],
            "at": self.at,
            "holds": self.holds,
            "seen": dict(self.seen),
            "table": self._table,
            "to_search": list(self._to_search),
            "counts": [self._rounds, self._tries, self._losses, self._failed_drives, self._requests],
            "behind": self._behind.name,
            "given_at": None if self._given_at is None else self._given_at.tolist(),
            "givers": {name: [*giver[:-1], *giver.xy_m] for name, giver in self._givers.items()},
            "is_where_given": self._is_where_given,
            "used_s": self._clock() - self._began_s,
            "ends": [[_plain(one.order), one.is_done, one.reason, one.duration_s] for one in self.ends],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` returned: with the same step of the same task."""
        self.holds, self.seen = memory["holds"], dict(memory["seen"])
        for (task, thing, place), is_done, reason, duration_s in memory["ends"]:
            self.ends.append(TaskEnd(TaskOrder(Task(task), thing, place), is_done, reason, duration_s))
        self.orders = tuple(TaskOrder(Task(task), *rest) for task, *rest in memory["orders"])
        self.at = memory["at"]
        self._table, self._to_search = memory["table"], list(memory["to_search"])
        self._rounds, self._tries, self._losses, self._failed_drives, self._requests = memory["counts"]
        self._behind = HouseholdState[memory["behind"]]
        self._given_at = None if memory["given_at"] is None else np.array(memory["given_at"])
        self._is_where_given = memory["is_where_given"]
        for name, (has_one_leg, is_aside, away_m, x, y) in memory["givers"].items():
            self._givers[name] = _Giver(has_one_leg, is_aside, away_m, (x, y))
        self._began_s = self._clock() - memory["used_s"]
        last = HouseholdState[memory["state"]]
        ways = (*WAYS[self._behind], last) if last is HouseholdState.DOOR else WAYS[last]
        for state in ways if self.orders else ():
            self.machine.go(state, "goes on after a restart")


def _plain(order: TaskOrder) -> list[str]:
    return [str(order.task), order.object, order.place]
