"""Touch to go: an operator presses a place in a camera's picture, sees the way there, and drives it."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui

from robbie_mp.messages import ControlState, PathPlanned, PlanPath, Point, Pose, PoseStamped, Quaternion
from robbie_mp.station.context import header_of_now
from robbie_mp.station.floor.camera_model import NoFloor
from robbie_mp.station.floor.sight import MAX_SLOPE_RAD, Spot, checked
from robbie_mp.station.map.goals import GOAL, Placement, place
from robbie_mp.station.map.marks import CellMarks, MapMark
from robbie_mp.station.map.way import way_points

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from nicegui.events import GenericEventArguments

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.floor.picture import FloorPicture
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.page.requests import Asked
    from robbie_mp.station.watch.latest import Latest

FINDS_WITHIN_S = 3.0
KEPT_S = 30.0
"""A way that nobody has driven for this time is not proposed any more."""
SHIFTED_M = 0.2
"""If a correction of the map moves the place by more than this, the operator must press it again."""
MOVED_M = 0.3
"""When the robot has moved by this, another way is planned to the same place."""
PERIOD_S = 0.5
"""Least time between two plans of one page."""
MAX_POINTS = 60
"""Maximum number of points of a way in a picture."""
DOT_M = 0.05
COLOUR = "#7b1fa2"


@dataclass(frozen=True)
class Proposal:
    """A way that an operator may drive.

    Attributes:
        number: no other proposal has it.
        spot: where it leads.
        way: `[x, y]`, m, map frame.
        made_s: when the place was pressed.
    """

    number: int
    spot: Spot
    way: list[list[float]]
    made_s: float

    @property
    def is_over(self) -> bool:
        """Whether nobody has driven it for too long."""
        return time.monotonic() - self.made_s > KEPT_S

    @property
    def length_m(self) -> float:
        """How long the way is."""
        return sum(math.dist(one, other) for one, other in itertools.pairwise(self.way))


class Proposals:
    """The proposals of all pages, for the map.

    Args:
        pages: the keys of the open pages.
    """

    def __init__(self, pages: Container[str]) -> None:
        self._pages = pages
        self._of_pages: dict[str, Proposal] = {}
        self._numbers = itertools.count(1)

    def number(self) -> int:
        """Return a number that no proposal has yet."""
        return next(self._numbers)

    def put(self, page: str, proposal: Proposal | None) -> None:
        """Replace the proposal of a page. None: it has none."""
        others = {key: one for key, one in self._of_pages.items() if key in self._pages and key != page}
        self._of_pages = others if proposal is None else {**others, page: proposal}

    def _now(self) -> list[Proposal]:
        return [one for key, one in self._of_pages.items() if key in self._pages and not one.is_over]

    def marks(self) -> Iterator[MapMark]:
        """Return the places to which ways are proposed."""
        for one in self._now():
            yield MapMark("proposed", COLOUR, one.spot.x_m, one.spot.y_m, 0.0)

    def cells(self) -> CellMarks:
        """Return dots along the ways."""
        ways = self._now()
        dots = [dotted(np.array(one.way)) for one in ways]
        revision = hash(tuple((one.number, *map(tuple, one.way)) for one in ways))
        return CellMarks(revision, np.concatenate([np.zeros((0, 2)), *dots]), DOT_M)


def dotted(way: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return points (M, 2) along a way (N, 2), at twice the distance of `DOT_M`."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at_m = np.arange(0.0, along_m[-1], 2 * DOT_M)
    return np.stack([np.interp(at_m, along_m, axis) for axis in way.T], axis=1)


class TouchToGo:
    """What the operator of one page does with the floor in pictures.

    A goal that is sent is the same as one that is set on the map, and so are the rules for it.

    Args:
        station: finds the floor, and knows how the robot moves.
        page: sends requests and goals.
        proposals: shows ways on the map.
        pose: the robot's newest pose on the map.
        control: the newest control state.
    """

    def __init__(
        self,
        station: StationContext,
        page: Page,
        proposals: Proposals,
        pose: Latest[PoseStamped],
        control: Latest[ControlState],
    ) -> None:
        self._floor, self._motion, self._clock = station.robot.floor, station.robot.motion, station.clock
        self._page, self._proposals, self._pose, self._control = page, proposals, pose, control
        self._asked: tuple[Spot, float, Asked] | None = None
        self._proposal: Proposal | None = None
        self._presses = 0
        self._next_s = -math.inf

    def listen(self, picture: FloorPicture) -> None:
        """Take what is pressed in a picture."""
        picture.show(presses=True)
        picture.on("touch", self._on_touch)
        picture.on("go", self._on_go)
        picture.on("cancel", lambda _event: self._withdraw())

    def shown(self) -> dict[str, object] | None:
        """Return what a page shows of the proposal now; None if there is none."""
        self._look()
        if self._proposal is None:
            is_waiting = self._asked is not None
            return {"number": 0, "text": "Looking for a way …"} if is_waiting else None
        one = self._proposal
        text = f"{one.length_m:.1f} m to drive"
        goal = [round(one.spot.x_m, 3), round(one.spot.y_m, 3)]
        return {"number": one.number, "text": text, "way": one.way, "goal": goal}

    async def _on_touch(self, event: GenericEventArguments) -> None:
        touch = checked(event.args)
        if touch is None or not self._page.may("the way"):
            return
        self._withdraw()
        self._presses += 1
        press = self._presses
        try:
            self._check_moment()
            self._next_s = time.monotonic() + PERIOD_S
            spot = await asyncio.wait_for(asyncio.wrap_future(self._floor.locate(touch)), FINDS_WITHIN_S)
        except NoFloor as error:
            ui.notify(f"No way there: {error}", type="negative")
        except asyncio.TimeoutError:
            ui.notify("No way there: the robot does not answer", type="negative")
        else:
            if press == self._presses:  # and nothing has been pressed since
                self._plan(spot, time.monotonic())

    def _check_moment(self) -> None:
        """Check that the robot can find a way now.

        Raises:
            NoFloor: it cannot.
        """
        if why := tilted(self._motion.now.pitch_rad, self._motion.now.roll_rad):
            raise NoFloor(why)
        if time.monotonic() < self._next_s:
            raise NoFloor("that was too quick after the last press: press again")

    def _plan(self, spot: Spot, made_s: float, *, is_first: bool = True) -> None:
        pose = Pose(position=Point(x=spot.x_m, y=spot.y_m), orientation=Quaternion.from_yaw(0.0))
        goal = PoseStamped(header=header_of_now(self._clock, "map"), pose=pose)
        eye = [Point(x=spot.eye[0], y=spot.eye[1])] if is_first else []
        asked = self._page.ask(PlanPath(pose=goal, seen_from=eye), "the way")
        self._next_s = time.monotonic() + PERIOD_S
        self._asked = None if asked is None else (spot, made_s, asked)

    def _look(self) -> None:
        """Take the way that was planned; withdraw it when it does not hold any more."""
        if self._asked is not None and self._asked[2].has_ended:
            (spot, made_s, asked), self._asked = self._asked, None
            if isinstance(asked.reply, PathPlanned) and (way := way_points(asked.reply.path, MAX_POINTS)):
                number = self._proposals.number() if self._proposal is None else self._proposal.number
                self._propose(Proposal(number, spot, way, made_s))
            else:
                self._withdraw()  # the page says why
        if self._proposal is None:
            return
        if why := self._is_void(self._proposal):
            self._withdraw()
            ui.notify(why, type="negative")
        elif self._asked is None and time.monotonic() >= self._next_s and self._has_moved(self._proposal):
            self._plan(self._proposal.spot, self._proposal.made_s, is_first=False)

    def _propose(self, proposal: Proposal | None) -> None:
        self._proposal = proposal
        self._proposals.put(self._page.key, proposal)

    def _withdraw(self) -> None:
        """Forget what was pressed."""
        self._presses += 1
        self._asked = None
        self._propose(None)

    def _is_void(self, proposal: Proposal) -> str:
        """Return why a proposal does not hold any more; '' if it does."""
        if proposal.is_over:
            return "The way was not driven for long: press the place again"
        now = self._floor.place_of(proposal.spot)
        if now is None:
            return "The way is not proposed any more: the robot's position on the map is not known"
        if math.dist(now, (proposal.spot.x_m, proposal.spot.y_m)) > SHIFTED_M:
            return "The map was corrected, and the place has moved on it: press it again"
        return ""

    def _has_moved(self, proposal: Proposal) -> bool:
        robot = self._pose.message
        return (
            robot is not None
            and math.dist(proposal.way[0], (robot.pose.position.x, robot.pose.position.y)) > MOVED_M
        )

    def _on_go(self, event: GenericEventArguments) -> None:
        proposal = self._proposal
        sent = event.args.get("number") if isinstance(event.args, dict) else None
        if proposal is None or sent != proposal.number:
            return  # it was withdrawn while the order was under way
        if (why := self._is_void(proposal)) or not self._page.may_move("the goal"):
            self._withdraw()
            if why:
                ui.notify(why, type="negative")
            return
        self._withdraw()
        place(
            self._page,
            self._clock,
            Placement(GOAL, proposal.spot.x_m, proposal.spot.y_m, None),
            self._pose.message,
        )
        control = self._control.message
        if control is not None and control.mode != ControlState.AUTO:
            ui.notify("The robot drives there as soon as it is told to go on")


def tilted(pitch_rad: float | None, roll_rad: float | None) -> str:
    """Return why the picture of a tilted robot does not tell where the floor is; '' if it does."""
    tilt_rad = max(abs(pitch_rad or 0.0), abs(roll_rad or 0.0))
    if tilt_rad <= MAX_SLOPE_RAD:
        return ""
    return f"the robot is tilted by {math.degrees(tilt_rad):.0f}°, and the floor ahead may not be"
