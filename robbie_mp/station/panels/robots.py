"""All robots of the team on one page: how each is, a stop for all of them, and the way to drive one."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element

from robbie_mp.messages import RobotSummary
from robbie_mp.station.fleet.stop_all import OWN
from robbie_mp.station.fleet.summary import MAX_ALARMS
from robbie_mp.station.fleet.topics import PREVIEW
from robbie_mp.station.page.identity import COLOUR
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.cameras import NewestImage
from robbie_mp.station.watch.latest import silence

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.fleet.robots import OtherRobot
    from robbie_mp.station.page.page import Page

REFRESH_S = 0.3
LOW_CHARGE = 0.2
MAX_TEXT, MAX_ALARM_TEXT, MAX_ADDRESS = 40, 200, 300
"""Maximum number of characters that are shown of what another robot tells."""
STYLE = Path(__file__).parent / "robots.css"


class StopAllButton(Element, component="stop_all.js"):
    """Stops all robots. The page's emergency stop keeps the press until each has confirmed it."""


class RobotCard(Element, component="robot_card.js"):
    """Shows one robot, and has the button to drive it."""

    def show(self, now: dict[str, Any]) -> None:
        """Show a state, if it has changed."""
        if self._props.get("now") != now:
            self._props["now"] = now
            self.update()


class RobotsPanel(Panel):
    """Shows a card for each robot."""

    name = "robots"
    title = "All robots"
    icon = "smart_toy"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._team, self._cameras = station.team, station.robot.cameras

    @classmethod
    def is_wanted(cls, station: StationContext) -> bool:
        """Return whether the robot has a team."""
        return station.team is not None

    def build(self, page: Page) -> None:
        """Build the stop, and a card for each robot that the link has met."""
        ui.add_css(STYLE)
        if self._team is None:
            ui.label("The link of this robot does not tell other robots apart: see prefix_topics.")
            return
        StopAllButton()
        box = ui.element("div").classes("robot-cards")
        cards: dict[str, tuple[RobotCard, RobotPicture]] = {}

        def update() -> None:
            for name in self._names():
                if name not in cards:
                    with box, ui.element("article").classes("robot-card").props(f'data-robot="{name}"'):
                        card, picture = RobotCard(), RobotPicture()
                    card.on("hold", partial(self.hold, page, name))
                    cards[name] = card, picture
                card, picture = cards[name]
                picture.show(self._camera(name))
                card.show(self._shown(page, name))

        update()
        page.every(REFRESH_S, self.name, update)

    def hold(self, page: Page, name: str) -> None:
        """Let another robot stand; its page, on which the operator takes it over, opens meanwhile."""
        robot = self._team.all.get(name) if self._team is not None else None
        if robot is None or not page.may("the order to hold"):
            return
        if not robot.hold():
            ui.notify("the order to hold was not sent: the robot's memory is full", type="negative")

    def _names(self) -> list[str]:
        return [OWN] if self._team is None else [OWN, *sorted(self._team.all)]

    def _camera(self, name: str) -> str:
        if self._team is None or name == OWN:
            return self._team.own_camera if self._team is not None else ""
        camera = f"{name}/{PREVIEW}"
        return camera if camera in self._cameras.previews else ""

    def _shown(self, page: Page, name: str) -> dict[str, Any]:
        assert self._team is not None
        if name == OWN:
            return {**told(self._team.own), "robot": OWN, "stale": "", "mayHold": False}
        robot = self._team.all[name]
        stale = stale_text(robot)
        shown = told(robot.summary.message)
        # Two robots may tell the same name, and stops go by those of the link.
        title = name if shown["name"] in ("", name) else f"{name} ({shown['name']})"
        if self._team.own is not None and shown["page"] == self._team.own.page:
            shown["page"] = ""  # 127.0.0.1 here is not the other robot
        may_hold = page.can_command and bool(shown["page"]) and not stale
        return {**shown, "robot": name, "stale": stale, "name": title, "mayHold": may_hold}


class RobotPicture:
    """The picture of one robot, of the camera that it has now."""

    def __init__(self) -> None:
        self._camera: str | None = None
        self._box = ui.element("div").classes("robot-picture")

    def show(self, camera: str) -> None:
        """Show the pictures of a camera; '': there is none."""
        if camera == self._camera:
            return
        self._camera = camera
        self._box.clear()
        with self._box:
            if camera:
                NewestImage(camera)
            else:
                ui.label("no picture yet").classes("no-picture")


def told(summary: RobotSummary | None) -> dict[str, Any]:
    """Return the contents of a robot's card from its last summary."""
    if summary is None:
        summary = RobotSummary(battery=math.nan)
    battery = summary.battery
    return {
        "name": summary.robot[:MAX_TEXT],
        "colour": summary.colour if COLOUR.fullmatch(summary.colour) else "",
        "page": summary.page if is_address(summary.page) else "",
        "mode": summary.mode[:MAX_TEXT],
        "state": summary.state[:MAX_TEXT],
        "battery": round(100 * battery) if math.isfinite(battery) else None,
        "low": battery < LOW_CHARGE,
        "alarms": [[int(one.level), one.text[:MAX_ALARM_TEXT]] for one in summary.alarms[:MAX_ALARMS]],
    }


def is_address(text: str) -> bool:
    """Return whether a text may be the address of a page."""
    return text.startswith(("http://", "https://")) and len(text) <= MAX_ADDRESS


def stale_text(robot: OtherRobot) -> str:
    """Return how old the data of a stale robot is; '' if the robot is not stale."""
    if not robot.is_stale:
        return ""
    age_s = robot.age_s
    if age_s is None:
        return "no data yet" if robot.is_up else "no link, no data yet"
    link = "" if robot.is_up else "no link; "
    return f"{link}what is shown is {silence(age_s, 0.0) or '0 s'} old"
