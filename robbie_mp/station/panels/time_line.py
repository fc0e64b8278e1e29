"""The live time line: what has happened in this run, and each moment of it beside the present."""

from __future__ import annotations

import math
import threading
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import ui
from nicegui.element import Element
from starlette.responses import Response

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.utc import time_of_day
from robbie_mp.logs.black_box.clip_folder import CLIPS
from robbie_mp.logs.black_box.happenings import HappeningKind
from robbie_mp.station.map.marks import MapMark
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.cameras import NewestImage
from robbie_mp.station.panels.happened import LOOKS, clips_in, kept_by_hand
from robbie_mp.station.past.files import SNAPSHOT_PATH
from robbie_mp.station.past.moments import Moment, read_moment
from robbie_mp.station.watch.pictures import serve_pictures
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from nicegui.events import GenericEventArguments

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page

LOOK_S = 1.0
REFRESH_S = 0.3
MAX_POINTS = 300
MAX_RESTARTS = 300
MAX_MOMENTS = 16
"""Of those that pages have looked at, so many keep their pictures."""
EARLY_S = 1.0
"""A picture that was taken so long before the moment says so."""
MOMENT_PATH = "/moments/"
RESTART = "restart"
LANES = {
    HappeningKind.VICTIM: "Victims",
    HappeningKind.MARK: "Marks",
    HappeningKind.STOP: "Stops",
    HappeningKind.CRASH: "Restarts",
    HappeningKind.HANG: "Restarts",
    HappeningKind.FAILED: "Restarts",
    RESTART: "Restarts",
}
"""The line of each kind; OTHER for all others."""
OTHER = "Other"
GHOST = "#7e57c2"
STYLE = Path(__file__).parent / "time_line.css"


class TimePoint(NamedTuple):
    """Something on the time line."""

    key: str
    """Identifies it among all points."""
    time_s: float
    """Seconds since 1970."""
    kind: str
    text: str
    clip: str = ""
    """Name of the clip that shows it; '': there is none."""
    picture: str = ""
    """Path of the snapshot that it is; '': it is none."""


class TimeLine(Element, component="time_line.js"):
    """Draws the points by time; a press on one chooses it."""

    def show(self, now: dict[str, Any]) -> None:
        """Show these points, if they have changed."""
        if self._props.get("now") != now:
            self._props["now"] = now
            self.update()


class TimeLinePanel(Panel):
    """Shows when things happened; a press on one shows that moment beside the present."""

    name = "timeline"
    title = "Time line"
    icon = "access_time"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._station = station
        self._folder = station.run.output_directory
        self._next_s = 0.0
        self._restarts: dict[tuple[str, int], float] = {}
        self._one_at_a_time = threading.Lock()
        self._moments: dict[int, Moment] = {}
        self._number = 0
        self._shown: dict[str, Moment] = {}
        """The moment that each page shows, by the pages' keys."""
        self.points: tuple[TimePoint, ...] = ()
        """By time. The tuple is replaced and never changed, because pages read it."""
        self.begin_s = time.time()
        station.map.marks.add("moments", lambda: [*self._ghosts()])
        serve_pictures(f"{MOMENT_PATH}{{number}}/{{index}}", self._picture)

    def tick(self) -> None:
        """Look what has happened, if a page shows it."""
        if self.is_looked_at and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + LOOK_S
            found = [*self._kept(), *self._restarted()]
            self.points = tuple(sorted(found, key=lambda point: point.time_s)[-MAX_POINTS:])

    def _kept(self) -> Iterator[TimePoint]:
        """Yield what clips and snapshots show."""
        for row in clips_in(self._folder):
            if row.happening is not None:
                clip = row.happening.clip
                yield TimePoint(f"{clip}/{row.time_s}/{row.text}", row.time_s, row.kind, row.text, clip)
        for row in kept_by_hand(self._folder, self._station.run.recorder.name):
            picture = row.path if row.path.startswith(SNAPSHOT_PATH) else ""
            yield TimePoint(row.path, row.time_s, row.kind, row.text, picture=picture)

    def _restarted(self) -> Iterator[TimePoint]:
        """Yield the restarts of modules that this station has seen."""
        reading = self._station.run.figures.reading
        if reading is None:
            return
        now_s = time.time()
        began_ns = min((one.started_ns for one in reading.modules if one.started_ns), default=reading.at_ns)
        self.begin_s = now_s - (time.monotonic_ns() - began_ns) / 1e9
        for one in reading.modules:
            if one.restarts and one.started_ns:
                at_s = now_s - (time.monotonic_ns() - one.started_ns) / 1e9
                self._restarts.setdefault((one.name, one.started_ns), at_s)
        while len(self._restarts) > MAX_RESTARTS:
            self._restarts.pop(next(iter(self._restarts)))
        for (name, _), at_s in self._restarts.items():
            yield TimePoint(f"{name}/{at_s}", at_s, RESTART, f"{name} was started again")

    def live_camera(self, camera: str) -> str:
        """Return the live camera whose topic a clip names; '': it sends nothing now."""
        found = self._station.robot.cameras.found
        names = (camera, f"{camera}/compressed", camera.removesuffix("/compressed"))
        return next((name for name in names if name in found), "")

    def _ghosts(self) -> Iterator[MapMark]:
        """Yield where the robot was in the moments that operators look at."""
        pages = self._pages
        for key, moment in tuple(self._shown.items()):
            if key in pages and moment.pose is not None and pages[key].role is Role.OPERATOR:
                x, y, _ = moment.pose
                yield MapMark(f"robot at {time_of_day(moment.time_s)[:8]}", GHOST, x, y, 0.0)

    def _picture(self, number: int, index: int) -> Response:
        """Answer with a picture of a moment; runs in a thread of the page server."""
        pictures = [*self._moments[number].pictures.values()] if number in self._moments else []
        if not 0 <= index < len(pictures):
            return Response("there is no such picture\n", 404)
        data = pictures[index]
        media_type = "image/png" if data.startswith(b"\x89PNG") else "image/jpeg"
        return Response(data, media_type=media_type, headers={"Cache-Control": "no-store"})

    def choose(self, point: TimePoint, is_chosen: Callable[[], bool]) -> tuple[int, Moment] | None:
        """Read a moment, in a thread; None if another one has been chosen meanwhile.

        Raises:
            OSError: its clip cannot be read.
            RobbieError: the clip is damaged.
        """
        with self._one_at_a_time:
            if not is_chosen():
                return None
            moment = read_moment(self._folder / CLIPS / point.clip, point.time_s, point.text)
            self._number += 1
            kept = [*self._moments.items()][-MAX_MOMENTS + 1 :]
            self._moments = {**dict(kept), self._number: moment}
            return self._number, moment

    def build(self, page: Page) -> None:
        """Build the line, and below it the moment that was chosen."""
        ui.add_css(STYLE)
        line = TimeLine()
        beside = MomentBeside(self, page)
        line.on("choose", partial(self._on_choose, beside))

        def update() -> None:
            line.show(self._line(beside.chosen))
            beside.update()

        update()
        page.every(REFRESH_S, self.name, update)

    def show(self, page: Page, moment: Moment | None) -> None:
        """Note which moment a page shows; None: none."""
        open_pages = {key: one for key, one in self._shown.items() if key in self._pages}
        open_pages.pop(page.key, None)
        self._shown = open_pages if moment is None else {**open_pages, page.key: moment}

    def _line(self, chosen: str) -> dict[str, Any]:
        now_s = time.time()
        begin_s = min(self.begin_s, now_s)
        points = [
            {
                "key": one.key,
                # The clock may have been set since: then it is at an end of the line, but never lost.
                "at": round(min(max(one.time_s, begin_s), now_s), 1),
                "lane": LANES.get(one.kind, OTHER),
                "icon": LOOKS[one.kind][0] if one.kind in LOOKS else "restart_alt",
                "text": f"{time_of_day(one.time_s)[:8]} {one.text}",
                "shows": bool(one.clip or one.picture),
            }
            for one in self.points
        ]
        return {"begin": math.floor(begin_s), "points": points, "chosen": chosen, "now": math.ceil(now_s)}

    def _on_choose(self, beside: MomentBeside, event: GenericEventArguments) -> None:
        point = next((one for one in self.points if one.key == event.args), None)
        if point is not None:
            beside.choose(point)


class MomentBeside:
    """Shows the chosen moment of one page beside the present.

    Args:
        panel: reads moments.
        page: the page.
    """

    def __init__(self, panel: TimeLinePanel, page: Page):
        self._panel, self._page = panel, page
        self.chosen = ""
        """The key of the point; '': none was chosen."""
        self._result: tuple[int, Moment] | str | None = None
        with ui.element("div").classes("moment").props("id=moment") as self._box:
            self._hint()

    def _hint(self) -> None:
        ui.label("Press a point to see that moment beside the present.").classes("moment-text")

    def choose(self, point: TimePoint) -> None:
        """Show a point; pressed again, show none."""
        if point.key == self.chosen:
            self._close()
            return
        self.chosen = point.key
        self._panel.show(self._page, None)
        self._say(f"{point.text}: " + ("reading its clip …" if point.clip else "no clip shows it"))
        if point.picture:
            self._box.clear()
            with self._box, ui.element("figure"):
                show_image(f"{prefix()}{point.picture}", point.text)
                ui.element("figcaption").props("id=moment-title")
        elif point.clip:
            threading.Thread(target=self._read, args=(point,), name="reads a moment", daemon=True).start()

    def _read(self, point: TimePoint) -> None:
        try:
            result: tuple[int, Moment] | str | None = self._panel.choose(
                point, lambda: point.key == self.chosen
            )
        except (OSError, RobbieError) as error:
            result = f"{point.text}: its clip cannot be read: {error}"
        if point.key == self.chosen:
            self._result = result

    def update(self) -> None:
        """Show what was read."""
        result, self._result = self._result, None
        if isinstance(result, str):
            self._say(result)
        elif result is not None:
            self._show(*result)

    def _say(self, text: str) -> None:
        self._box.clear()
        with self._box:
            ui.label(text).classes("moment-text").props("role=status")

    def _close(self) -> None:
        self.chosen = ""
        self._panel.show(self._page, None)
        self._box.clear()
        with self._box:
            self._hint()

    def _show(self, number: int, moment: Moment) -> None:
        self._panel.show(self._page, moment)
        self._box.clear()
        with self._box:
            with ui.element("div").classes("moment-head"):
                ui.label(about(moment)).props("id=moment-title role=status")
                close = ui.button("Close", on_click=self._close)
                close.props("flat no-caps color=white id=moment-close")
                close.props["aria-label"] = "Close the moment"
            if not moment.pictures:
                ui.label("The clip has no picture of this moment.").classes("moment-text")
            for index, camera in enumerate(moment.pictures):
                self._build_pictures(number, index, camera, moment.early_s.get(camera, 0.0))

    def _build_pictures(self, number: int, index: int, camera: str, early_s: float) -> None:
        """Build what a camera saw then, or so long before, and what it sees now."""
        with ui.element("div").classes("moment-pair"):
            with ui.element("figure").classes("is-then"):
                path = f"{prefix()}{MOMENT_PATH}{number}/{index}"
                show_image(path, f"{camera}, then")
                with ui.element("figcaption"):
                    early = f", {early_s:.0f} s before" if early_s >= EARLY_S else ""
                    ui.label(f"THEN{early}: {camera}")
            with ui.element("figure"):
                found = self._panel.live_camera(camera)
                if found:
                    NewestImage(found)
                else:
                    ui.label("sends no pictures now").classes("no-picture")
                with ui.element("figcaption"):
                    ui.label(f"NOW: {camera}")


def show_image(path: str, text: str) -> None:
    """Show a picture. The name of a camera may come from another robot, so it is no HTML."""
    image = ui.element("img")
    image.props["src"], image.props["alt"] = path, text


def prefix() -> str:
    """Return the path below which a proxy serves the page."""
    request = ui.context.client.request
    return str(request.scope.get("root_path", "")) if request is not None else ""


def about(moment: Moment) -> str:
    """Return a moment in words."""
    parts = [f"{time_of_day(moment.time_s)[:8]}: {moment.text}"]
    if moment.mode:
        parts.append(moment.mode)
    if moment.pose is not None:
        parts.append(f"the robot was at {moment.pose[0]:.1f} m, {moment.pose[1]:.1f} m")
    return "; ".join(parts)
