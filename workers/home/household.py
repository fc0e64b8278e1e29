"""Carries out the orders of a household, one task after another. It decides; it does not drive or grasp.

Call `step` a few times each second, and do what `state` and `goal` say.
Each task is a procedure that reads from top to bottom; its journal survives a restart.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.procedure import Failed, Journal, Procedure, WrongJournal, pause
from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.household_states import DRIVES, TRANSITIONS, HouseholdSettings, HouseholdState
from robbie_robots.workers.home.orders import NEEDS_ARM, Task, TaskOrder, WrongOrder, check_orders
from robbie_robots.workers.home.takers import Takers

Array = NDArray[np.float64]

MAX_SAYINGS = 8
MAX_ENDS = 100
TAKE_IT = "Here is the {}. Please take it."
COME = "I have the {}. Please come to me."
OPEN_DOOR = "Please open the door to the {}."
UNEXPLAINED = "no reason was given"
SAYS_IT_ITSELF = {Task.FOLLOW, Task.WHO}
"""Tasks of other modules, which say themselves how they have ended."""


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


class _Drove(NamedTuple):
    """Navigation has reached the goal (''), or has given it up for a reason."""

    problem: str


class _Ended(NamedTuple):
    """The arm, or another module, has ended what it had to do."""

    is_done: bool
    reason: str
    is_refused: bool


class HouseholdWork:
    """Carries out one order at a time, which has one or several tasks.

    Its owner drives to `goal`, has the arm or other modules do what `state` says, and tells how each ends.

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
        self._takers = Takers(self.settings)
        self._sayings: deque[str] = deque(maxlen=MAX_SAYINGS)
        self._began_s = clock()
        self._destination = ""
        self._meeting: tuple[Array, Array] | None = None
        self._is_near_person = self._has_called = False
        self._requests = 0
        self._ahead_m = 0.0
        self._journal = Journal()
        self._work = Procedure[None]()

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
        if self.state is HouseholdState.MEET:
            return self._meeting[0] if self._meeting is not None else None
        if self.state is HouseholdState.DOOR:
            return np.array(self.doors[self._destination])
        if self.state not in DRIVES:
            return None
        return self._place(self._destination) if self._destination else self._takers.given_at

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
        self._takers.order_is_given_here()
        self._go_on(Journal())

    def cancel(self, reason: str) -> bool:
        """End the order; the robot stands, and holds what it holds. Return whether there was one."""
        if not self._work.cancel():
            return False
        self._end(False, reason)
        self.orders, self.at = (), 0
        return True

    async def _carry_out(self) -> None:
        """Do one task after another; one that fails ends the order."""
        while (order := self.order) is not None:
            self._journal.once(self._begin_task)
            if await self._is_done(order) and self.at + 1 < len(self.orders):
                self.at += 1
            else:
                self.orders, self.at = (), 0
            self._journal.clear()

    async def _is_done(self, order: TaskOrder) -> bool:
        """Do a task, and return whether that has worked."""
        try:
            self._end(True, await self._do(order))
        except Failed as error:
            self._end(False, str(error))
            if order.task not in SAYS_IT_ITSELF:
                self._sayings.append(f"I could not {order.text}: {error}.")
            return False
        return True

    def _begin_task(self) -> None:
        order = self.orders[self.at]
        self._began_s, self._requests, self._meeting = self._clock(), 0, None
        self._is_near_person = self._has_called = False
        self._takers.begin_task()
        if order.task is not Task.LEARN:
            self._sayings.append(f"I {order.text}.")

    def _end(self, is_done: bool, reason: str) -> None:
        self.ends.append(TaskEnd(self.orders[self.at], is_done, reason, self._clock() - self._began_s))
        if self.state is not HouseholdState.IDLE:
            self.machine.go(HouseholdState.IDLE, reason)
        if not is_done and self.has_arm:
            self.holds = self._hand_holds

    # -- tasks -------------------------------------------------------------------------------------------

    async def _do(self, order: TaskOrder) -> str:
        """Do a task, and return how it has ended."""
        match order.task:
            case Task.GO:
                await self._drive(HouseholdState.GO, order.place, order.text)
                return "there"
            case Task.LEARN:
                reason = await self._have_done(HouseholdState.LEARN, order.text)
                self._sayings.append(f"This is the {order.place}.")
                return reason
            case Task.FOLLOW:
                reason = await self._have_done(HouseholdState.FOLLOW, order.text)
                self._takers.order_is_given_here()  # the person is here now
                return reason
            case Task.WHO:
                return await self._have_done(HouseholdState.WHO, order.text)
            case Task.BRING | Task.PUT:
                return await self._bring_or_put(order)

    async def _have_done(self, state: HouseholdState, reason: str) -> str:
        """Have another module do something, and return how it has ended."""
        ended = await self._end_of(state, reason)
        if not ended.is_done:
            raise Failed(ended.reason)
        return ended.reason

    async def _bring_or_put(self, order: TaskOrder) -> str:
        """Fetch an object unless the hand holds it, and deliver it; again if the hand loses it."""
        has_it = self._journal.once(lambda: bool(self.holds) and order.object in ("", self.holds))
        if not has_it and not order.object:
            raise Failed("there is nothing in the hand")
        tables, problem = self._tables_for(order.object), ""
        for _ in range(self.settings.max_tries):
            if not has_it:
                await self._fetch(order.object, tables, problem)
            problem = await self._deliver(order)
            if not problem:
                return f"it is on the {order.place}" if order.task is Task.PUT else "handed over"
            if not order.object:
                break
            has_it = False
        raise Failed(problem)

    async def _fetch(self, name: str, tables: Iterator[str], problem: str) -> None:
        """Pick the object up from the first table on which it is.

        Args:
            name: of the object.
            tables: those on which it may be.
            problem: why the robot has to fetch it once more; '' if it has not.
        """
        for table in tables:
            problem = await self._journal.step(self._pick_up_at(table, name))
            if not problem:
                return
        raise Failed(problem or "I know no table")

    async def _pick_up_at(self, table: str, name: str) -> str:
        """Pick an object up from a table, again while it is there; return '', or why the robot cannot."""
        reason, problem = f"looks on the {table}", ""
        for _ in range(self.settings.max_tries):
            problem = await self._journal.step(self._come_to(HouseholdState.FETCH, table, reason))
            if problem:
                return f"cannot come to the {table}: {problem}"
            problem, is_here = await self._journal.step(self._pick_up(table, name))
            if not problem or not is_here:
                break
            reason = f"once more: {problem}"
        return problem

    async def _pick_up(self, table: str, name: str) -> tuple[str, bool]:
        """Pick an object up; return '', or why the robot cannot, and whether it has seen it here."""
        self._journal.once(lambda: self.seen.pop(name, None))
        ended = await self._end_of(HouseholdState.PICK, f"in front of the {table}")
        if not ended.is_done:
            return ended.reason, self.seen.get(name) == table
        self.holds = name
        self.seen.pop(name, None)
        return "", True

    async def _deliver(self, order: TaskOrder) -> str:
        """Hand over what the hand holds, or put it down; return '', or why the hand has nothing."""
        puts, problem, again = order.task is Task.PUT, "", ""
        for turn in range(self.settings.max_tries):
            if puts or turn == 0:
                await self._drive(HouseholdState.CARRY, order.place, again or f"holds {self.holds}")
            work = self._put(order.place) if puts else self._hand_over(again or "where the order was given")
            problem, is_empty = await self._journal.step(work)
            if not problem or is_empty:
                return problem
            again = f"once more: {problem}"
        raise Failed(problem)

    async def _put(self, place: str) -> tuple[str, bool]:
        """Put down what the hand holds; return '', or why the arm cannot, and whether the hand was empty."""
        ended = await self._end_of(HouseholdState.PUT, f"in front of the {place}")
        if ended.is_done and self.holds:
            self.seen[self.holds] = place
        return self._let_go(ended)

    async def _hand_over(self, reason: str) -> tuple[str, bool]:
        """Hand over what the hand holds to a person; return the same as `_put`."""
        found = await self._journal.step(self._meet(reason))
        ended = await self._end_of(HouseholdState.HAND, found)
        if not ended.is_done and not ended.is_refused:
            self._takers.refuses()
            self._meeting = None
        return self._let_go(ended)

    def _let_go(self, ended: _Ended) -> tuple[str, bool]:
        if ended.is_done or ended.is_refused:
            self.holds = ""
        return "" if ended.is_done else ended.reason, ended.is_refused

    # -- what another module does ------------------------------------------------------------------------

    async def _end_of(self, state: HouseholdState, reason: str) -> _Ended:
        """Have the arm, or another module, do what a state says, and return how that has ended."""
        self._enter(state, reason)
        while not isinstance(event := await self._next(), _Ended):
            pass
        return event

    def _enter(self, state: HouseholdState, reason: str) -> None:
        """Change the state, unless the robot was in it, or in a later one, before a restart."""
        if not self._journal.is_replaying and state is not self.state:
            self.machine.go(state, reason)

    async def _next(self) -> object:
        """Wait for what happens next; None: only time has passed."""
        event = await pause()
        if event is None and self.machine.is_late:
            raise Failed(f"{self.state.value}: that took too long")
        return event

    # -- driving -----------------------------------------------------------------------------------------

    async def _drive(self, state: HouseholdState, place: str, reason: str) -> None:
        """Drive to a place without which the task fails; '' is where the order was given."""
        if problem := await self._journal.step(self._come_to(state, place, reason)):
            raise Failed(problem)

    async def _come_to(self, state: HouseholdState, place: str, reason: str) -> str:
        """Drive to a place, also through its door; return '', or why the robot cannot come there."""
        self._destination = place
        self._enter(state, reason)
        problem = ""
        for _ in range(self.settings.max_tries):
            while problem := await self._journal.step(self._arrival()):
                if place not in self.doors or not self._journal.once(self._may_ask):
                    break
                reason = await self._journal.step(self._pass_door(problem))
                self._enter(state, reason)
            else:
                return ""
        return problem

    async def _arrival(self) -> str:
        """Wait until the robot is where it should be; return '', or why navigation has given up."""
        while True:
            event = await self._next()
            if isinstance(event, _Drove) and (event.problem or self._stands_right()):
                return event.problem

    def _stands_right(self) -> bool:
        """Return whether the robot stands right for its arm; anywhere near will do without it."""
        goal, pose, order = self.goal, self._takers.pose, self.order
        if self.state is HouseholdState.GO:
            return True
        if goal is None or pose is None or order is None:
            return False
        if self.state is HouseholdState.CARRY and order.task is Task.BRING:
            return True
        turned_rad = math.remainder(float(goal[2] - pose[2]), math.tau)
        near = math.dist(goal[:2], pose[:2]) <= self.settings.at_table_m
        return near and abs(turned_rad) <= self.settings.at_table_rad

    def _may_ask(self) -> bool:
        return self._requests < self.settings.max_requests

    async def _pass_door(self, problem: str) -> str:
        """Wait before the door, and ask for it, until it is open; return why the robot drives on."""
        self._enter(HouseholdState.DOOR, f"cannot come to the {self._destination}: {problem}")
        while not isinstance(event := await self._next(), _Drove):
            pass
        reason = self._cannot_wait(event)
        while not reason and self._may_ask():
            self._requests += 1
            self._ahead_m = 0.0
            self._sayings.append(OPEN_DOOR.format(self._destination))
            reason = await self._open_door()
        return reason or "nobody has opened the door"

    async def _open_door(self) -> str:
        """Wait for a time until the door is open; return why the robot drives on, or ''."""
        asked_s = self._clock()
        while self._clock() - asked_s < self.settings.door_s:
            event = await self._next()
            if isinstance(event, _Drove) and (reason := self._cannot_wait(event)):
                return reason
            # Only after a step, the owner sends the new goal before the end of the one at the door counts.
            if event is None and self._ahead_m >= self.settings.open_m:
                return "the door is open"
        return ""

    def _cannot_wait(self, drove: _Drove) -> str:
        """Return why the robot cannot wait at the door, and ask for no door any more; '' if it can."""
        if not drove.problem:
            return ""
        self._requests = self.settings.max_requests
        return f"cannot come to the door: {drove.problem}"

    # -- persons and objects -----------------------------------------------------------------------------

    async def _meet(self, reason: str) -> str:
        """Come to the person who takes what the robot brings; return how near that is."""
        self._enter(HouseholdState.MEET, reason)
        while True:
            event = await self._next()
            self._is_near_person = self._is_near_person or isinstance(event, _Drove)
            if event is None and (found := self._approach()):
                return found

    def _approach(self) -> str:
        """Choose where to meet a person; return how near somebody is who can take it now, or ''."""
        pose = self._takers.pose
        if pose is None:
            return ""
        waits = self.machine.time_in_state_s < self.settings.wait_s
        xy_m = self._takers.taker(waits)
        if xy_m is None:
            if self._meeting is None and (givers := self._takers.likely_givers()):
                self._come_near(givers[0])  # the person may be hidden from here
            if not waits and not self._has_called:
                self._has_called = True
                self._sayings.append(COME.format(self.holds))
            return ""
        away_m, bearing = self._takers.direction(xy_m)
        aside_rad = abs(math.remainder(bearing - float(pose[2]), math.tau))
        limit_m = self.settings.far_m if self._is_near_person else self.settings.near_m
        has_moved = self._meeting is None or math.dist(self._meeting[1], xy_m) > self.settings.moved_m
        if away_m <= limit_m and aside_rad <= self.settings.ahead_rad:
            self._sayings.append(TAKE_IT.format(self.holds))
            self._takers.offer_to(xy_m)
            return f"a person is {away_m:.1f} m away"
        if has_moved or self._is_near_person:
            self._come_near(xy_m)
        return ""

    def _come_near(self, xy_m: Array) -> None:
        """Drive to the place before a person; only turn if that is near enough, or nearer is not possible."""
        pose = self._takers.pose
        assert pose is not None
        away_m, bearing = self._takers.direction(xy_m)
        before_m = self.settings.before_m
        before = xy_m - before_m * np.array([math.cos(bearing), math.sin(bearing)])
        if away_m <= (self.settings.far_m if self._is_near_person else before_m):
            before = pose[:2]
        self._meeting = np.array([*before, bearing]), xy_m
        self._is_near_person = False

    def _tables_for(self, name: str) -> Iterator[str]:
        """Yield tables on which an object may be: where it was seen last, then the nearest; each twice."""
        for _ in range(self.settings.rounds):
            yield from self._journal.once(lambda: self._ranked_tables(name))

    def _ranked_tables(self, name: str) -> list[str]:
        known = [table for table in self._tables if table in self.places]
        last = self.seen.get(name)
        return sorted(known, key=lambda table: (table != last, self._way_m(table)))

    def _way_m(self, name: str) -> float:
        place, pose = self._place(name), self._takers.pose
        return math.inf if place is None or pose is None else math.dist(place[:2], pose[:2])

    def _place(self, name: str) -> Array | None:
        return np.array(self.places[name]) if name in self.places else None

    # -- what happens ------------------------------------------------------------------------------------

    def step(self) -> None:
        """Let time pass: end what takes too long, and find a person who takes what the robot brings."""
        self._work.tell()

    def arrived(self) -> None:
        """Record that navigation has reached the goal; in front of a table, the pose must be right."""
        self._work.tell(_Drove(""))

    def unreachable(self, reason: str) -> None:
        """Record that navigation has given the goal up; the owner sends it again."""
        self._work.tell(_Drove(reason or UNEXPLAINED))

    def ended(self, is_done: bool, reason: str = "", is_refused: bool = False) -> None:
        """Record how the arm, or another module, has ended what `state` says.

        Args:
            is_done: whether it is done.
            reason: why it ended, in plain words.
            is_refused: whether the arm did not even begin: the hand is not what the robot took it for.
        """
        self._work.tell(_Ended(is_done, reason or UNEXPLAINED, is_refused))

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._takers.pose = np.asarray(pose, float)
        if self._takers.given_at is None and self.orders:
            self._takers.order_is_given_here()
        self._takers.note_givers()

    def see_persons(self, persons: Iterable[PersonReport]) -> None:
        """Take all persons that are tracked now."""
        self._takers.persons = list(persons)
        self._takers.note_givers()

    def see_things(self, things: Iterable[PersonReport]) -> None:
        """Take what looks like the legs of standing persons, but is on the map: it may be furniture."""
        self._takers.things = list(things)

    def see_hand(self, holds: str) -> None:
        """Take what the arm says that it holds; without an order, others may have used it."""
        self.has_arm, self._hand_holds = True, holds
        if not self.orders:
            self.holds = holds

    def see_objects(self, names: Iterable[str]) -> None:
        """Take what stands on the table in front of the robot."""
        if self.state is HouseholdState.PICK:
            self.seen.update(dict.fromkeys(names, self._destination))

    def see_ahead(self, range_m: float) -> None:
        """Take how far the laser sees straight ahead; so the robot notices that a door is open."""
        self._ahead_m = range_m

    # -- restarts ----------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what the next process needs to go on, as plain data."""
        return {
            "state": self.state.name,
            "orders": [_plain(one) for one in self.orders],
            "at": self.at,
            "journal": self._journal.memory,
            "destination": self._destination,
            "requests": self._requests,
            "holds": self.holds,
            "seen": dict(self.seen),
            "takers": self._takers.memory(),
            "used_s": self._clock() - self._began_s,
            "ends": [[_plain(one.order), one.is_done, one.reason, one.duration_s] for one in self.ends],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` returned: with the same step of the same task."""
        self.holds, self.seen = memory["holds"], dict(memory["seen"])
        for (task, thing, place), is_done, reason, duration_s in memory["ends"]:
            self.ends.append(TaskEnd(TaskOrder(Task(task), thing, place), is_done, reason, duration_s))
        self.orders = tuple(TaskOrder(Task(task), *rest) for task, *rest in memory["orders"])
        self.at, self._destination, self._requests = memory["at"], memory["destination"], memory["requests"]
        self._takers.remember(memory["takers"])
        self._began_s = self._clock() - memory["used_s"]
        if self.orders:
            self.machine.resume(HouseholdState[memory["state"]], "goes on after a restart")
            self._go_on(Journal(memory["journal"]))

    def _go_on(self, journal: Journal) -> None:
        """Begin or go on with the order; a journal of another version of this program ends it."""
        self._journal = journal
        try:
            self._work.begin(self._carry_out())
        except WrongJournal as error:
            self._end(False, str(error))
            self.orders, self.at = (), 0


def _plain(order: TaskOrder) -> list[str]:
    return [str(order.task), order.object, order.place]
