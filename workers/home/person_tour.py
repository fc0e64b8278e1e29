"""The tasks "learn this person" and "who is who": the robot drives to persons, and looks at their faces.

Call `step` a few times each second and carry out what it returns. A face counts for a person only if the
picture shows it in the person's direction. A person who has shown no face does not count, because legs
of furniture may look like a person's. So on its way through the rooms, the robot turns its camera to whatever
looks like legs: `person_places`.
"""

import math
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from strenum import StrEnum

from robbie_mp.base.procedure import Failed, Procedure, pause
from robbie_mp.base.state_machine import StateMachine, TimeOut
from robbie_robots.workers.home.area_search import AreaSearch
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.person_places import Eye, PersonPlace, PersonPlaces, SeenFace

Array = NDArray[np.float64]

MAX_MET = 32


class TourState(StrEnum):
    """What the robot does."""

    IDLE = "waits for an order"
    SEARCH = "drives where it has not looked for persons"
    CHOOSE = "looks for the person in front of it"
    APPROACH = "drives to a person"
    LOOK = "looks at the person's face"
    LEARN = "has the face learnt"


_S = TourState
TRANSITIONS = {
    _S.IDLE: {_S.SEARCH, _S.CHOOSE},
    _S.SEARCH: {_S.APPROACH, _S.IDLE},
    _S.CHOOSE: {_S.APPROACH, _S.IDLE},
    _S.APPROACH: {_S.LOOK, _S.IDLE},
    _S.LOOK: {_S.LEARN, _S.SEARCH, _S.IDLE},
    _S.LEARN: {_S.LOOK, _S.IDLE},
}


@dataclass(frozen=True)
class TourSettings:
    """How the robot meets persons.

    Attributes:
        beside_m: The robot drives to this distance from a person ...
        check_m: ... or to this one, to see whether there is a face at all.
        likely: It goes to those whose legs are legs with this probability, or have walked; at others, it only
            looks in passing.
        glance_m: While it searches, its camera turns to legs that are at most this far away ...
        glance_rad: ... and this far beside the robot's heading.
        front_m: The person whose face is to be learnt is at most this far away ...
        front_rad: ... and at most this far beside the robot's heading.
        same_m: A person this near to where one was met is taken for the same person.
        faces: Number of pictures of a face in which a known person must have the same name.
        most_faces: An unknown person has shown the face in this number of pictures.
        tries: How often it drives to somebody who has walked or shown a face, and shows none there.
        teachings: How often it has the face learnt again if that was refused.
        choose_s: Time to find the person in front.
        approach_s: Time to drive to a person.
        look_s: Time to look at a face.
        gone_s: Whose legs are not seen for this time is not there any more.
        learn_s: Time to learn it.
        tour_s: The whole tour ends after this time, with those who were met.
    """

    beside_m: float = 1.1
    check_m: float = 1.7
    likely: float = 0.65
    glance_m: float = 2.5
    glance_rad: float = 2.2
    front_m: float = 2.5
    front_rad: float = 0.6
    same_m: float = 0.7
    faces: int = 3
    most_faces: int = 6
    tries: int = 2
    teachings: int = 3
    choose_s: float = 8.0
    approach_s: float = 25.0
    look_s: float = 5.0
    gone_s: float = 2.5
    learn_s: float = 5.0
    tour_s: float = 300.0

    def time_outs(self) -> dict[TourState, TimeOut[TourState]]:
        """Return the states that end after a time."""
        return {
            _S.CHOOSE: TimeOut(self.choose_s, _S.IDLE),
            _S.APPROACH: TimeOut(self.approach_s, _S.LOOK),
            _S.LEARN: TimeOut(self.learn_s, _S.LOOK),
        }


class Met(NamedTuple):
    """A person whose face the robot has looked at.

    Attributes:
        name: '' if the robot does not know this person.
        xy_m: m, map frame.
        faces: number of pictures of the face.
    """

    name: str
    xy_m: tuple[float, float]
    faces: int


@dataclass(frozen=True)
class TourOrders:
    """The robot's current order.

    Attributes:
        goal: `(3,)`, x, y (m) and heading (rad), map frame. None: stand still.
        look_at_xy_m: whose face to look at, m, map frame. None: look ahead.
    """

    goal: Array | None = None
    look_at_xy_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class TourEnd:
    """How an order ended.

    Attributes:
        is_done: whether it was carried out.
        reason: in plain words.
        duration_s: of the order.
    """

    is_done: bool
    reason: str
    duration_s: float


@dataclass
class _Candidate:
    """The person whom the robot is about to look at."""

    place: PersonPlace
    goal: Array | None = None
    faces: list[str] = field(default_factory=list)
    seen_s: float = -math.inf


class _Drove(NamedTuple):
    """The robot has reached its latest goal, or cannot; why it drives there no more."""

    reason: str


class _Taught(NamedTuple):
    """The face of `to_learn` is known (''), or could not be learnt for a reason."""

    problem: str


class PersonTour:
    """Carries out one order at a time.

    Args:
        clock: Returns the time in s.
        settings: How to meet persons.
        on_change: Called with each new state.

    Attributes:
        machine: The state machine, and why it entered the current state.
        met: The persons met in this tour, where they are.
        learns: The name of the person whose face is to be learnt; '' during a round.
        end: How the last order ended; None: it has not.
        to_learn: The face that is to be learnt now; its owner calls `learnt` or `not_learnt`.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        settings: TourSettings | None = None,
        on_change: Callable[[TourState], None] = lambda _state: None,
    ) -> None:
        self.settings = settings or TourSettings()
        self.machine = StateMachine(TourState.IDLE, TRANSITIONS, clock, self.settings.time_outs(), on_change)
        self._clock = clock
        self._persons: dict[str, PersonReport] = {}
        self._pose: Array | None = None
        self._area = AreaSearch(clock)
        self._work = Procedure[None]()
        self._begin("", 0)

    def _begin(self, learns: str, wanted: int) -> None:
        self.learns, self._wanted = learns, wanted
        self.met: list[Met] = []
        self._places_of_met: list[PersonPlace] = []
        self.places = PersonPlaces()
        self._area.begin()
        self._heading_rad: float | None = None
        self._candidate: _Candidate | None = None
        self.to_learn: SeenFace | None = None
        self._began_s = self._clock()
        self.end: TourEnd | None = None

    @property
    def state(self) -> TourState:
        """Return what the robot does."""
        return self.machine.state

    # -- orders ----------------------------------------------------------------------------------------

    def go_round(self, persons: int) -> None:
        """Look for persons; there must be no other order.

        Args:
            persons: Ends when it has met that many; 0: when it has looked everywhere.
        """
        self._begin("", persons)
        self._work.begin(self._carry_out(self._meet_all(persons or MAX_MET)))

    def learn(self, name: str) -> None:
        """Learn the person in front of the robot; there must be no other order."""
        self._begin(name, 0)
        self._work.begin(self._carry_out(self._learn(name)))

    def cancel(self, reason: str) -> None:
        """End the order."""
        if self._work.cancel():
            self._end(False, reason)

    async def _carry_out(self, task: Coroutine[Any, Any, str]) -> None:
        try:
            self._end(True, await task)
        except Failed as error:
            self._end(False, str(error))

    async def _meet_all(self, wanted: int) -> str:
        """Meet a number of persons, or all that there are; return why the round ends."""
        reason = "was asked who is who"
        while len(self.met) < wanted:
            place = await self._search(reason)
            if place is None:
                return "has looked everywhere"
            candidate = _Candidate(place)
            reason = await self._look(candidate, await self._approach(candidate))
        return f"has met {len(self.met)} persons"

    async def _learn(self, name: str) -> str:
        """Have the face of the person in front of the robot learnt."""
        candidate = _Candidate(await self._choose(f"is to learn {name}"))
        reason = await self._approach(candidate)
        for _ in range(self.settings.teachings):
            face = await self._face(candidate, reason)
            problem = await self._have_learnt(face)
            if not problem:
                return f"knows {name}"
            reason = f"once more: {problem}"
        raise Failed(problem)

    # -- steps -----------------------------------------------------------------------------------------

    async def _choose(self, reason: str) -> PersonPlace:
        """Return the nearest person in front of the robot, rather one whose legs are likely legs."""
        self.machine.go(TourState.CHOOSE, reason)
        while not self.machine.is_late:
            near = self._in_front() if await pause() is None else []
            if near:
                return near[0]
        raise Failed("nobody is in front of the robot")

    def _in_front(self) -> list[PersonPlace]:
        near = []
        for one in self._persons.values():
            place = self.places.at(one.name)
            away_m, aside = self._away(one.xy_m)
            is_in_front = away_m <= self.settings.front_m and abs(aside) <= self.settings.front_rad
            if place is not None and place.is_seen and is_in_front:
                near.append((not self._is_likely(place), away_m, one.name, place))
        return [place for *_, place in sorted(near)]

    async def _search(self, reason: str) -> PersonPlace | None:
        """Drive where the robot has not looked until somebody is seen; at the end, return who is left."""
        self.machine.go(TourState.SEARCH, reason)
        area = self._area
        while True:
            event = await pause()
            if isinstance(event, _Drove):
                area.leave_place()
            if event is not None:
                continue
            new = self._ranked([place for place in self._new() if place.faces or self._is_likely(place)])
            if at_once := [place for place in new if place.faces or (place.is_seen and not place.looks)]:
                return at_once[0]
            robot = self._robot_xy_m
            if not area.look(robot) or not area.needs_place:
                continue
            area.choose(robot, self._heading_rad)
            if area.place is None:
                return new[0] if new else None
            # It stays the same on the way: each new goal restarts navigation.
            self._heading_rad = math.atan2(area.place[1] - robot[1], area.place[0] - robot[0])

    async def _approach(self, candidate: _Candidate) -> str:
        """Drive to a person; return why the robot goes no nearer."""
        self._candidate, self._area.place = candidate, None
        self.machine.go(TourState.APPROACH, f"has not met person {candidate.place.track}")
        while not self._is_beside(candidate):
            event = await pause()
            if isinstance(event, _Drove):
                return event.reason
            if self.machine.is_late:
                return "that took too long"
        return "is beside the person"

    def _is_beside(self, candidate: _Candidate) -> bool:
        is_sure = self.learns or candidate.place.faces or candidate.place.has_moved
        near_m = self.settings.beside_m + 0.2 if is_sure else self.settings.check_m
        return self._away(candidate.place.xy_m)[0] <= near_m

    async def _look(self, candidate: _Candidate, reason: str) -> str:
        """Look at a face until it is clear whose it is, and note that; return what the robot has seen."""
        self.machine.go(TourState.LOOK, reason)
        while self._may_show_face(candidate):
            event = await pause()
            if not isinstance(event, SeenFace):
                continue
            candidate.faces.append(event.name)
            named = Counter(filter(None, candidate.faces)).most_common(1)
            if named and named[0][1] >= self.settings.faces:
                return self._meet(named[0][0], candidate)
            if len(candidate.faces) >= self.settings.most_faces:
                break
        if candidate.faces:
            return self._meet("", candidate)
        self._leave(candidate.place)
        return "saw no face"

    def _may_show_face(self, candidate: _Candidate) -> bool:
        """Return whether it is worth while to look on: not for long, nor at a thing, or where nobody is."""
        if candidate.place.is_seen:
            candidate.seen_s = self._clock()
        looked_s = self.machine.time_in_state_s
        is_gone = min(looked_s, self._clock() - candidate.seen_s) >= self.settings.gone_s
        return looked_s < self.settings.look_s and candidate.place.is_open and not is_gone

    def _leave(self, place: PersonPlace) -> None:
        """Note that a place shows no face; the robot comes back only to somebody who may be a person."""
        self._candidate = None
        place.looks += 1
        may_be_person = place.has_moved or place.faces > 0
        place.is_open = place.is_open and may_be_person and place.looks < self.settings.tries

    def _meet(self, name: str, candidate: _Candidate) -> str:
        """Note who this is, and where."""
        place, self._candidate = candidate.place, None
        place.is_open = False
        kept = [index for index, one in enumerate(self.met) if not name or one.name != name]
        self.met = [*(self.met[index] for index in kept), Met(name, place.xy_m, len(candidate.faces))]
        self._places_of_met = [*(self._places_of_met[index] for index in kept), place]
        return f"has met {name or 'somebody unknown'}"

    async def _face(self, candidate: _Candidate, reason: str) -> SeenFace:
        """Return the next face that the person shows."""
        self.machine.go(TourState.LOOK, reason)
        while self.machine.time_in_state_s < self.settings.look_s:
            if isinstance(event := await pause(), SeenFace):
                return event
        raise Failed("sees no face")

    async def _have_learnt(self, face: SeenFace) -> str:
        """Have a face learnt; return '', or why it was not."""
        self.to_learn = face
        self.machine.go(TourState.LEARN, "sees the face")
        event = None
        while not isinstance(event, _Taught) and not self.machine.is_late:
            event = await pause()
        self.to_learn = None
        return event.problem if isinstance(event, _Taught) else "that took too long"

    def _new(self) -> list[PersonPlace]:
        """Return the places at which the robot has to look."""
        same_m = self.settings.same_m
        return [
            place
            for place in self.places.open
            if all(math.dist(one.xy_m, place.xy_m) > same_m for one in self.met)
        ]

    def _ranked(self, places: list[PersonPlace]) -> list[PersonPlace]:
        """Return places: first those where a person is most likely, then the nearest."""
        return sorted(places, key=lambda one: (not one.faces, one.looks, self._away(one.xy_m)))

    def _is_likely(self, place: PersonPlace) -> bool:
        return place.has_moved or place.confidence >= self.settings.likely

    def _away(self, xy_m: tuple[float, float]) -> tuple[float, float]:
        """Return the distance of a place, m, and its angle beside the robot's heading, rad."""
        assert self._pose is not None
        x, y = np.asarray(xy_m) - self._pose[:2]
        return math.hypot(x, y), math.remainder(math.atan2(y, x) - float(self._pose[2]), math.tau)

    @property
    def _robot_xy_m(self) -> tuple[float, float]:
        assert self._pose is not None
        return float(self._pose[0]), float(self._pose[1])

    def _end(self, is_done: bool, reason: str) -> None:
        self.end = TourEnd(is_done, reason, self._clock() - self._began_s)
        self._candidate = self.to_learn = None
        self.machine.go(TourState.IDLE, reason)

    # -- what happens ----------------------------------------------------------------------------------

    def see_pose(self, pose: ArrayLike) -> None:
        """Take the robot's pose (x, y, heading), m and rad, map frame."""
        self._pose = np.asarray(pose, float)

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: Sequence[float]) -> None:
        """Take the newest map: see `SeenArea.see_map`."""
        self._area.see_map(cells, resolution_m, corner_xy_m)

    def see_persons(self, persons: Sequence[PersonReport]) -> None:
        """Take all legs that are tracked now, those on the map, too."""
        self._persons = {one.name: one for one in persons}
        self.places.see(persons)
        for index, place in enumerate(self._places_of_met):  # who was met may walk on
            self.met[index] = self.met[index]._replace(xy_m=place.xy_m)

    def see_faces(self, faces: Sequence[SeenFace], eye: Eye) -> None:
        """Take the faces of a picture.

        Args:
            faces: all of them.
            eye: the camera at the picture's time.
        """
        place = None if self._candidate is None else self._candidate.place
        for where, face in self.places.see_faces(faces, eye, place):
            if where is place:
                self._work.tell(face)

    def learnt(self) -> None:
        """Record that the face of `to_learn` is known."""
        self._work.tell(_Taught(""))

    def not_learnt(self, reason: str) -> None:
        """Record that the face of `to_learn` could not be learnt; the robot tries another picture."""
        self._work.tell(_Taught(reason or "no reason was given"))

    def arrived(self) -> None:
        """Record that the robot has reached its latest goal."""
        self._work.tell(_Drove("is beside the person"))

    def unreachable(self, reason: str) -> None:
        """Record that the robot cannot reach its latest goal."""
        self._work.tell(_Drove(reason))

    def step(self) -> TourOrders:
        """Decide what the robot does now, and return it."""
        if self._pose is None:
            return TourOrders()
        is_late = not self.learns and self._clock() - self._began_s >= self.settings.tour_s
        if is_late and self._work.cancel():
            self._end(True, f"the tour ends after {self.settings.tour_s:g} s")
        self._work.tell()
        return self._orders()

    def _orders(self) -> TourOrders:
        candidate, place = self._candidate, self._area.place
        if self.state is TourState.SEARCH and place is not None and self._heading_rad is not None:
            return TourOrders(np.array([*place, self._heading_rad]), self._glance())
        if candidate is None:
            return TourOrders()
        goal = self._beside(candidate) if self.state is TourState.APPROACH else None
        return TourOrders(goal, candidate.place.xy_m)

    def _glance(self) -> tuple[float, float] | None:
        """Return where the camera looks while the robot searches: to the nearest legs."""
        near = []
        for place in self._new():
            away_m, aside = self._away(place.xy_m)
            if place.is_seen and away_m <= self.settings.glance_m and abs(aside) <= self.settings.glance_rad:
                near.append((away_m, place.xy_m))
        return min(near)[1] if near else None

    def _beside(self, candidate: _Candidate) -> Array:
        """Return the place beside a person, heading there; it is kept as long as the person hardly moves."""
        assert self._pose is not None
        xy_m, beside_m, goal = candidate.place.xy_m, self.settings.beside_m, candidate.goal
        if goal is not None and abs(math.dist(goal[:2], xy_m) - beside_m) < 0.3:
            return goal
        away = np.subtract(xy_m, self._pose[:2])
        heading = math.atan2(away[1], away[0])
        x, y = np.asarray(xy_m) - beside_m * away / math.hypot(*away)
        candidate.goal = np.array([x, y, heading])
        return candidate.goal

    # -- restarts --------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return what a restarted task needs to go on, as plain data."""
        return {
            "is_idle": self.state is TourState.IDLE,
            "learns": self.learns,
            "wanted": self._wanted,
            "met": [[one.name, *one.xy_m, one.faces] for one in self.met],
            "places": self.places.memory(),
            "used_s": self._clock() - self._began_s,
            "end": None if self.end is None else [self.end.is_done, self.end.reason, self.end.duration_s],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` returned: with the same order, and those who were met."""
        if not memory["is_idle"]:
            if memory["learns"]:
                self.learn(memory["learns"])
            else:
                self.go_round(memory["wanted"])
        self.met = [Met(name, (x, y), faces) for name, x, y, faces in memory["met"]]
        self.places.remember(memory["places"])
        self._places_of_met = [PersonPlace(one.xy_m, "", is_open=False) for one in self.met]
        self._began_s = self._clock() - memory["used_s"]
        self.end = None if memory["end"] is None else TourEnd(*memory["end"])
