"""The task "follow me": the robot drives behind a person, on the same way. It decides; it does not drive.

Call `step` a few times each second and carry out what it returns. The robot takes another person for the one
that it has lost only if the track was continuous or the clothes are alike; otherwise it asks.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.state_machine import StateMachine
from robbie_robots.workers.home.area_search import AreaSearch
from robbie_robots.workers.home.follow_states import (
    FOLLOWS,
    SEARCHES,
    TRANSITIONS,
    FollowSettings,
    FollowState,
)
from robbie_robots.workers.people.clothes import blended, similarity

Array = NDArray[np.float64]

TRAIL_STEP_M, MAX_TRAIL = 0.1, 100
MAX_LOOKS = 6
"""Pictures of each person that count."""
LEARN_SHARE = 0.1
"""Share of a new picture in what the robot knows of the person's clothes."""
MAX_SAYINGS = 8

I_FOLLOW = "I follow you."
NOBODY = "I see nobody in front of me."
ARE_YOU_THERE = "Are you still there? Please say: here I am."
STAND_IN_FRONT = "I am not sure who you are. Please stand in front of me, and say: here I am."
FOUND = "There you are."
STOPPED = "I stop."
GIVEN_UP = "I have lost you. I stop here."


@dataclass(frozen=True)
class PersonReport:
    """What is known about a person.

    Attributes:
        name: the same as long as the person is tracked.
        xy_m: m, map frame.
        velocity_m_per_s: map frame.
        unseen_s: time since it was seen.
        has_moved: whether it has moved since it was first seen.
        confidence: 0 to 1, how likely its legs are legs.
        two_legs: 0 to 1, how often two legs were seen lately.
    """

    name: str
    xy_m: tuple[float, float]
    velocity_m_per_s: tuple[float, float] = (0.0, 0.0)
    unseen_s: float = 0.0
    has_moved: bool = False
    confidence: float = 1.0
    two_legs: float = 1.0


@dataclass(frozen=True)
class FollowOrders:
    """The robot's current order.

    Attributes:
        goal: `(3,)`, x, y (m) and heading (rad), map frame. None: stand still.
        look_at_xy_m: m, map frame. None: look around.
    """

    goal: Array | None = None
    look_at_xy_m: tuple[float, float] | None = None


class Follow:
    """Follows a person whenever it is ordered to.

    Args:
        clock: Returns the time in s.
        settings: How to follow.
        on_change: Called with each new state.

    Attributes:
        machine: The state machine, and why it entered the current state.
        person: The name of the person that it follows, or has lost; '' if there is none.
        last_xy_m: Where that person was seen last, m, map frame.
        losses: How often it lost the person.
        questions: How often it asked.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        settings: FollowSettings | None = None,
        on_change: Callable[[FollowState], None] = lambda _state: None,
    ) -> None:
        self.settings = settings or FollowSettings()
        time_outs = self.settings.time_outs()
        self.machine = StateMachine(FollowState.IDLE, TRANSITIONS, clock, time_outs, on_change)
        self.losses = self.questions = 0
        self._clock = clock
        self._persons: dict[str, PersonReport] = {}
        self._pose: Array | None = None
        self._stopped: str | None = None
        self._sayings: deque[str] = deque(maxlen=MAX_SAYINGS)
        self._goal: tuple[Array, float] | None = None
        self._area = AreaSearch(clock)
        self._forget_person()

    def _forget_person(self) -> None:
        self.person = ""
        self.last_xy_m: tuple[float, float] | None = None
        self._last_velocity = (0.0, 0.0)
        self._seen_s = -math.inf
        self._trail: deque[tuple[float, float]] = deque(maxlen=MAX_TRAIL)
        self._clothes: Array | None = None
        self._likeness: dict[str, deque[float]] = {}
        self._unlike = 0
        self._sure: tuple[tuple[float, float], tuple[float, float], float] | None = None
        self._is_here_s = -math.inf
        self._asked_s = -math.inf
        self._area.begin()

    @property
    def state(self) -> FollowState:
        """Return what the robot does."""
        return self.machine.state

    @property
    def believed_xy_m(self) -> tuple[float, float] | None:
        """Return where the person is, as far as the robot knows, m, map frame.

        Somebody who is hidden for a moment is expected to walk on.
        """
        followed = self._followed()
        return followed.xy_m if followed is not None and self.state in FOLLOWS else self.last_xy_m

    @property
    def unseen_s(self) -> float:
        """Return the time since the person was seen; 0 if there is none."""
        return self._clock() - self._seen_s if self.last_xy_m is not None else 0.0

    @property
    def status(self) -> str:
        """Return what the robot does, and why, in one line."""
        who = f" {self.person}" if self.person else ""
        return f"{self.state}{who} ({self.machine.reason}); lost {self.losses} times, asked {self.questions}"

    # -- inputs ----------------------------------------------------------------------------------------

    def order_follow(self) -> bool:
        """Follow the person in front of the robot; return whether the order changes anything."""
        if self.state is not FollowState.IDLE:
            return False
        self._forget_person()
        self.machine.go(FollowState.CHOOSE, "was told to follow")
        return True

    def order_stop(self) -> bool:
        """Follow nobody any more; return whether the order changes anything."""
        if self.state is FollowState.IDLE:
            return False
        self._end("was told to stop", STOPPED)
        return True

    def order_here(self) -> bool:
        """Take it that the lost person is near; return whether the order changes anything."""
        if self.state not in SEARCHES:
            return False
        self._is_here_s = self._clock()
        return True

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._pose = np.asarray(pose, float)

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: Sequence[float]) -> None:
        """Take the newest map: see `SeenArea.see_map`."""
        self._area.see_map(cells, resolution_m, corner_xy_m)

    def see_persons(self, persons: Sequence[PersonReport]) -> None:
        """Take all persons that are tracked now."""
        self._persons = {one.name: one for one in persons}
        self._likeness = {name: seen for name, seen in self._likeness.items() if name in self._persons}
        followed = self._followed()
        if followed is not None and self.state in FOLLOWS:
            self._walk_on(followed)

    def see_clothes(self, clothes: Mapping[str, Array]) -> None:
        """Take how persons are dressed in the newest picture: see `clothes_in`."""
        for name, worn in clothes.items():
            if name not in self._persons:
                continue
            alike = None if self._clothes is None else similarity(self._clothes, worn)
            if alike is not None:
                self._likeness.setdefault(name, deque(maxlen=MAX_LOOKS)).append(alike)
            if name == self.person and self.state in FOLLOWS:
                self._judge_clothes(alike, worn)

    def see_stopped(self, reason: str | None) -> None:
        """Record why the robot cannot drive. None: it can."""
        self._stopped = reason

    def arrived(self) -> None:
        """Record that the robot has reached its latest goal."""
        if self.state is FollowState.LOST:
            self.machine.go(FollowState.LOOK, "is where the person was seen last")
        self._leave_place()

    def unreachable(self, reason: str) -> None:
        """Record that the robot cannot reach its latest goal."""
        self._goal = None
        if self.state is FollowState.LOST:
            self.machine.go(FollowState.LOOK, reason)
        self._leave_place()

    def _leave_place(self) -> None:
        """Search elsewhere: the robot was there, or cannot get there."""
        if self.state is FollowState.SEARCH:
            self._area.leave_place()

    # -- outputs ---------------------------------------------------------------------------------------

    def sayings(self) -> list[str]:
        """Return what the robot has to say, and forget it."""
        said = list(self._sayings)
        self._sayings.clear()
        return said

    def step(self) -> FollowOrders:
        """Decide what the robot does now, and return it."""
        if self._pose is None:
            return FollowOrders()
        if self.state is FollowState.CHOOSE:
            self._choose()
        elif self.state in FOLLOWS | SEARCHES and self._stopped is not None:
            self.machine.go(FollowState.HALT, self._stopped)
        elif self.state is FollowState.HALT and self._stopped is None:
            self.machine.go(FollowState.LOST, "it can drive again")
        elif self.state in FOLLOWS:
            self._judge_distance()
        elif self.state in SEARCHES:
            self._search()
        return self._orders()

    def _choose(self) -> None:
        """Take the nearest person in front of the robot."""
        assert self._pose is not None
        found = self._in_front()
        if found is not None:
            self._take(found, f"{math.dist(self._pose[:2], found.xy_m):.1f} m ahead", I_FOLLOW)
        elif self.machine.expire():
            self._sayings.append(NOBODY)

    def _in_front(self) -> PersonReport | None:
        assert self._pose is not None
        near_m, far_m = self.settings.start_m
        found = []
        for one in self._seen():
            x, y = np.asarray(one.xy_m) - self._pose[:2]
            aside = math.remainder(math.atan2(y, x) - float(self._pose[2]), math.tau)
            if near_m <= math.hypot(x, y) <= far_m and abs(aside) <= self.settings.start_rad:
                found.append((math.hypot(x, y), one.name, one))
        return min(found)[2] if found else None

    def _take(self, person: PersonReport, reason: str, saying: str) -> None:
        """Follow this person from now on."""
        assert self._pose is not None
        self.person, self._unlike, self._sure = person.name, 0, None
        self._likeness = {}
        self._trail.clear()
        self._trail.append((float(self._pose[0]), float(self._pose[1])))
        self._goal = None
        self.machine.go(FollowState.STAND, f"{person.name}: {reason}")
        if saying:
            self._sayings.append(saying)
        self._walk_on(person)

    def _walk_on(self, person: PersonReport) -> None:
        """Add where the person is to the trail."""
        if person.unseen_s > self.settings.fresh_s:
            return
        self.last_xy_m, self._last_velocity = person.xy_m, person.velocity_m_per_s
        self._seen_s = self._clock() - person.unseen_s
        if not self._trail or math.dist(self._trail[-1], person.xy_m) >= TRAIL_STEP_M:
            self._trail.append(person.xy_m)

    def _judge_clothes(self, alike: float | None, worn: Array) -> None:
        """Learn the person's clothes; notice if somebody else is followed."""
        if alike is not None and alike < self.settings.wrong:
            self._unlike += 1
            if self._unlike >= self.settings.looks:
                if self._sure is not None:  # since then, it has followed somebody else
                    self.last_xy_m, self._last_velocity, self._seen_s = self._sure
                self._lose(f"that is somebody else: clothes only {alike:.2f} alike")
            return
        if self._clothes is None:
            self._clothes = worn
        elif alike is None or alike < self.settings.sure:
            return
        self._unlike = 0
        self._clothes = blended(self._clothes, worn, LEARN_SHARE)
        if self.last_xy_m is not None:
            self._sure = self.last_xy_m, self._last_velocity, self._seen_s

    def _lose(self, reason: str) -> None:
        self.losses += 1
        self._likeness = {}
        self._goal = None
        self._area.begin()
        self.machine.go(FollowState.LOST, reason)

    def _judge_distance(self) -> None:
        """Drive, stand, or notice that the person is lost."""
        assert self._pose is not None
        assert self.last_xy_m is not None
        unseen_s, away_m = self.unseen_s, math.dist(self._pose[:2], self.last_xy_m)
        if unseen_s > self.settings.lost_s:
            self._lose(f"not seen for {unseen_s:.1f} s, {away_m:.1f} m away")
            return
        if self.state is FollowState.FOLLOW and away_m <= self.settings.near_m:
            self.machine.go(FollowState.STAND, f"{away_m:.1f} m away")
        elif self.state is FollowState.STAND and away_m >= self.settings.away_m:
            self.machine.go(FollowState.FOLLOW, f"{away_m:.1f} m away")

    def _search(self) -> None:
        """Find the person again, or ask; give up in the end."""
        found, reason = self._found_again()
        if found is not None:
            was_asked = self.state is FollowState.ASK
            self._take(found, reason, FOUND if was_asked else "")
            return
        self._look_on_map()
        state = self.state
        if self.machine.expire() and state is FollowState.ASK:
            self._end("the person did not come back", GIVEN_UP)
        elif self.state is FollowState.ASK and self._clock() - self._asked_s >= self.settings.ask_again_s:
            self._asked_s = self._clock()
            self.questions += 1
            is_unsure = self._is_here_s > -math.inf
            self._sayings.append(STAND_IN_FRONT if is_unsure else ARE_YOU_THERE)

    def _look_on_map(self) -> None:
        """Note what is in sight, and choose where to look next; ask if there is nothing more to search."""
        assert self._pose is not None
        area, robot = self._area, self._pose[:2].tolist()
        if self.state is FollowState.SEARCH and not area.has_map:
            self.machine.go(FollowState.ASK, "there is no map to search")
        if not area.look(robot) or self.state is not FollowState.SEARCH or not area.needs_place:
            return
        area.choose(robot, float(self._last_place()[2]))
        if area.place is None:  # the person may have walked to where the robot has looked before
            area.begin()
            area.look(robot)
            area.choose(robot)
        if area.place is None:
            self.machine.go(FollowState.ASK, "has looked everywhere")

    def _found_again(self) -> tuple[PersonReport | None, str]:
        """Return the lost person if the robot is sure, and why."""
        seen = {one.name: one for one in self._seen() if self._can_be(one)}
        by_clothes = self._by_clothes(list(seen.values()))
        if by_clothes is not None:
            return by_clothes
        same = seen.get(self.person)
        if same is not None and not self._is_unlike(same.name) and self._unlike < self.settings.looks:
            others = [one for one in self._seen() if one.name != same.name]
            alone = all(math.dist(one.xy_m, same.xy_m) >= self.settings.same_place_m for one in others)
            if alone or self._mean_likeness(same.name) >= self.settings.sure:
                return same, "the track was not lost"
        if self._clock() - self._is_here_s <= self.settings.ask_again_s:
            front = self._in_front()
            if front is not None and not self._is_unlike(front.name):
                return front, "the person said so, and stands in front"
        return None, ""

    def _by_clothes(self, persons: list[PersonReport]) -> tuple[PersonReport, str] | None:
        """Return the person with the same clothes, if all others' are different."""
        enough = {name: seen for name, seen in self._likeness.items() if len(seen) >= self.settings.looks}
        ranked = sorted(((float(np.mean(seen)), name) for name, seen in enough.items()), reverse=True)
        if not ranked or ranked[0][0] < self.settings.sure:
            return None
        if len(ranked) > 1 and ranked[1][0] > ranked[0][0] - self.settings.margin:
            return None
        best, name = ranked[0]
        for one in persons:
            if one.name == name:
                return one, f"clothes {best:.2f} alike"
        return None

    def _to_look_at(self) -> tuple[float, float] | None:
        """Return one after the other of the persons who may be the lost one, m, map frame."""
        settings = self.settings
        found = []
        for one in self._seen():
            looks = self._likeness.get(one.name, ())
            is_other = len(looks) >= settings.looks and float(np.mean(looks)) < settings.wrong
            if not is_other and self._can_be(one):
                found.append((one.name, one.xy_m))
        return sorted(found)[int(self._clock() / settings.glance_s) % len(found)][1] if found else None

    def _mean_likeness(self, name: str) -> float:
        seen = self._likeness.get(name)
        return float(np.mean(seen)) if seen else 0.0

    def _is_unlike(self, name: str) -> bool:
        seen = self._likeness.get(name)
        return bool(seen) and self._mean_likeness(name) < self.settings.sure

    def _can_be(self, person: PersonReport) -> bool:
        """Return whether the lost person can have walked there."""
        if self.last_xy_m is None:
            return False
        reach_m = 0.6 + self.settings.speed_m_per_s * (self._clock() - self._seen_s)
        return math.dist(person.xy_m, self.last_xy_m) <= reach_m

    def _seen(self) -> list[PersonReport]:
        return [one for one in self._persons.values() if one.unseen_s <= self.settings.fresh_s]

    def _followed(self) -> PersonReport | None:
        return self._persons.get(self.person) if self.person else None

    def _end(self, reason: str, saying: str) -> None:
        if self.state is not FollowState.IDLE:
            self.machine.go(FollowState.IDLE, reason)
        self._forget_person()
        self._sayings.append(saying)

    # -- goals -----------------------------------------------------------------------------------------

    def _orders(self) -> FollowOrders:
        if self.state is FollowState.FOLLOW:
            return FollowOrders(self._kept(self._behind()), self.last_xy_m)
        if self.state is FollowState.STAND:
            return FollowOrders(None, self.last_xy_m)
        look_at = self._to_look_at() if self.state in SEARCHES else None
        if self.state is FollowState.LOST and self.last_xy_m is not None:
            return FollowOrders(self._kept(self._last_place()), look_at or self._ahead_of_last())
        if self.state is FollowState.SEARCH and self._area.place is not None:
            return FollowOrders(self._kept(self._to_place(self._area.place)), look_at)
        return FollowOrders(None, look_at)

    def _to_place(self, place: tuple[float, float]) -> Array:
        """Return a place to search, heading there."""
        assert self._pose is not None
        away = np.subtract(place, self._pose[:2])
        return np.array([*place, math.atan2(away[1], away[0])])

    def _kept(self, goal: Array) -> Array:
        """Return the last goal as long as the new one hardly differs: each new goal restarts navigation."""
        now_s = self._clock()
        if self._goal is not None:
            last, since_s = self._goal
            is_near = math.dist(last[:2], goal[:2]) < self.settings.goal_step_m
            if is_near or now_s - since_s < self.settings.goal_period_s:
                return last
        self._goal = goal, now_s
        return goal

    def _behind(self) -> Array:
        """Return the place on the person's way that is `behind_m` before its end, heading to the person."""
        assert self._pose is not None
        assert self.last_xy_m is not None
        points = [*self._trail, self.last_xy_m]
        left_m = self.settings.behind_m
        place = points[0]
        for after, before in zip(reversed(points), list(reversed(points))[1:], strict=False):
            length = math.dist(after, before)
            if length >= left_m > 0.0:
                share = left_m / length
                place = (after[0] + share * (before[0] - after[0]), after[1] + share * (before[1] - after[1]))
                break
            left_m -= length
        heading = math.atan2(self.last_xy_m[1] - place[1], self.last_xy_m[0] - place[0])
        return np.array([*place, heading])

    def _last_place(self) -> Array:
        """Return where the person was seen last, heading where it went."""
        assert self._pose is not None
        assert self.last_xy_m is not None
        x, y = self.last_xy_m
        vx, vy = self._last_velocity
        if math.hypot(vx, vy) < 0.15:
            vx, vy = x - float(self._pose[0]), y - float(self._pose[1])
        return np.array([x, y, math.atan2(vy, vx)])

    def _ahead_of_last(self) -> tuple[float, float]:
        x, y, heading = self._last_place().tolist()
        return x + math.cos(heading), y + math.sin(heading)

    # -- restarts --------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what a restarted task needs to go on, as plain data."""
        follows = self.state not in (FollowState.IDLE, FollowState.CHOOSE) and self.last_xy_m is not None
        return {
            "follows": follows,
            "chooses": self.state is FollowState.CHOOSE,
            "person": self.person,
            "last": None if self.last_xy_m is None else [*self.last_xy_m, *self._last_velocity],
            "seen_s": self._seen_s,
            "clothes": None if self._clothes is None else self._clothes.astype(np.float32),
            "losses": self.losses,
            "questions": self.questions,
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Continue from the data that `memory` returned: the person counts as lost, for a moment."""
        self.losses, self.questions = memory["losses"], memory["questions"]
        if memory["chooses"]:
            self.machine.go(FollowState.CHOOSE, "was told to follow before a restart")
        if not memory["follows"]:
            return
        x, y, vx, vy = memory["last"]
        self.person, self.last_xy_m, self._last_velocity = memory["person"], (x, y), (vx, vy)
        self._seen_s = memory["seen_s"]
        if memory["clothes"] is not None:
            self._clothes = np.asarray(memory["clothes"], np.float64)
        for state in (FollowState.CHOOSE, FollowState.STAND, FollowState.LOST):
            self.machine.go(state, "goes on after a restart")
