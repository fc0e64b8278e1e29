"""The application that serves the page. Needs the extra `gui`."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING

from fastapi import FastAPI, Request
from nicegui import app, core, ui
from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse, Response

from robbie_mp.messages import OccupancyGrid
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.trace.log_limit import limited
from robbie_mp.station.context import context_of
from robbie_mp.station.driving.driver import Driver
from robbie_mp.station.fleet.robots import OtherRobots
from robbie_mp.station.fleet.stop_all import StopAll
from robbie_mp.station.fleet.summary import SummaryTeller
from robbie_mp.station.fleet.topics import has_team
from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.map import LiveMap
from robbie_mp.station.live.server import with_live
from robbie_mp.station.page import first_paint
from robbie_mp.station.page.alarms import AlarmBar
from robbie_mp.station.page.build import BrowserLink, PageParts, build_page
from robbie_mp.station.page.cockpit import TILE_PATH
from robbie_mp.station.page.control_bar import ControlBar
from robbie_mp.station.page.identity import identity_of
from robbie_mp.station.page.keeping import RecordButton, SnapshotButton
from robbie_mp.station.page.layouts import LayoutCollection, check_layout, default_layouts
from robbie_mp.station.page.moment_marker import MomentMarker
from robbie_mp.station.page.page import Page
from robbie_mp.station.page.playback_bar import PlaybackBar
from robbie_mp.station.page.state_strip import StateStrip
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS, load_panels, panels_in_order
from robbie_mp.station.past.banner import LogBanner, PastBanner
from robbie_mp.station.past.files import RunFiles
from robbie_mp.station.past.passing import with_clip_player
from robbie_mp.station.past.snapshots import Snapshots
from robbie_mp.station.stop.emergency_stop import EmergencyStopControl
from robbie_mp.station.web.connections import bounded_connections
from robbie_mp.station.web.gate import SESSION, SESSION_COOKIE, App, Gate, below, with_forwarded
from robbie_mp.station.web.page_events import PageEvents, with_known_packets
from robbie_mp.station.web.page_limit import with_page_limit
from robbie_mp.station.web.proxy import public_address
from robbie_mp.station.web.server import PageServer

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.module import StationModule
    from robbie_mp.station.panel import Panel
    from robbie_mp.station.web.access import Access

LIBRARIES = ("nicegui", "asyncio", "uvicorn.error", "engineio.server", "socketio.server")
"""Loggers of libraries that report invalid requests of visitors. Their rate is limited."""
LAYOUTS_FILE = "layouts.json"
"""Name of the file with the layouts of operators, if the profile sets no other place."""
MESSAGE_HISTORY = 100
"""Maximum number of messages kept for a disconnected page. A page that misses more of them reloads."""


def answer_plainly(_request: Request, error: Exception) -> Response:
    """Answer an error with a line of text, because NiceGUI would build a page for each such request."""
    status = error.status_code if isinstance(error, HTTPException) else 500
    return PlainTextResponse("there is no such thing here\n" if status == 404 else "failed\n", status)


def page_application() -> App:
    """Return the application of NiceGUI that serves the pages, without all that they do not need."""
    application = FastAPI(openapi_url=None)
    ui.run_with(
        application,
        dark=True,
        tailwind=False,  # see first_paint
        language="en-US",
        reconnect_timeout=10.0,
        binding_refresh_interval=None,
        message_history_length=MESSAGE_HISTORY,
        show_welcome_message=False,
    )
    # The page fetches images all the time; a bar that shows each of them loading tells nothing.
    core.app.config.quasar_config["loadingBar"]["skipHijack"] = True
    # Without long polling, each connection is a socket, which is counted, and closed with its session.
    core.sio.eio.transports = ["websocket"]
    core.app.config.socket_io_js_transports = ["websocket"]
    for code in (404, 500):
        app.add_exception_handler(code, answer_plainly)
    ui.menu_item.default_props("role=menuitem")  # and not listitem, which no menu may have
    for name in LIBRARIES:
        limited(name)
    return application


def make_panels(station: StationContext) -> tuple[dict[str, Panel], dict[str, str]]:
    """Create the panels of a station.

    Returns:
        The panels by name, and the names and titles of the tabs in their order. The robot's own panels are
        created even if no tab shows them, because they may have elements on every tab and on the map.
    """
    own = load_panels(station.settings.panels)
    classes = panels_in_order(own)
    wanted = [name for name, panel in classes.items() if panel.is_wanted(station)]
    titles = station.settings.tabs or dict.fromkeys(wanted, "")
    return {name: panel(station) for name, panel in classes.items() if name in titles or name in own}, titles


def layouts_of(station: StationContext, panels: Sequence[str]) -> LayoutCollection:
    """Return the layouts of a station: those of its profile, and its own for which the profile has no other.

    Args:
        station: the station.
        panels: names of the panels in the order of their tabs.
    """
    own = [name for name in panels if name not in FRAMEWORK_PANELS]
    given = {name: check_layout(name, places, panels) for name, places in station.settings.layouts.items()}
    layouts = {name: layout for name, layout in (default_layouts(panels, own) | given).items() if layout}
    upright = default_layouts(panels, own, upright=True)
    upright = {name: layout for name, layout in upright.items() if name not in given}
    file = station.settings.layouts_file or station.run.known.folder / LAYOUTS_FILE
    return LayoutCollection(layouts, panels, file, station.log, upright)


def team_of(module: StationModule, name: str) -> OtherRobots | None:
    """Return the other robots; None if no link of this one tells their topics from its own."""
    if not has_team(RunPlan.load(module.known_run.folder)):
        return None
    return OtherRobots(module, module.clock, module.publish, name)


class Website:
    """The page of a station and its server.

    Args:
        module: the station, which is just being set up.
        access: knows tokens and sessions.
        listener: the socket on which the station listens.
    """

    def __init__(self, module: StationModule, access: Access, listener: socket.socket):
        self._module, self._access = module, access
        self._identity = identity_of(module)
        self._context = station = context_of(module, team_of(module, self._identity.name))
        self._streams = VideoStreams(limited(f"{station.log.name}.video"))
        grid = station.messages.newest(OccupancyGrid, station.settings.map_topic)
        self._map = LiveMap(grid, station.live)
        panels, titles = make_panels(station)
        self._panels = [*panels.values()]
        team = station.team
        self._strip = StateStrip(station, self._panels, is_always_wanted=team is not None)
        self._teller: SummaryTeller | None = None
        past = station.settings.past_of
        self._emergency_stop = EmergencyStopControl(
            station.messages,
            station.clock,
            module.publish,
            can_release=not past,
            log_source=module.log_source,
        )
        if team is not None:
            self._tell_team(team)
        known = station.run.known
        RunFiles(known.folder, station.run.output_directory, known.record.profile if known.record else "")
        parts = self._parts([(panels[name], title or panels[name].title) for name, title in titles.items()])
        self._add_pages(parts, layouts_of(station, [*titles]))
        connections = bounded_connections(station.settings.trusted_proxies)
        public = public_address(station.settings.public_address)
        behind = self._beside_pages(below(public.path, page_application()))
        behind = with_clip_player(behind, station.run.player, access)
        # Browsers send cookies to all ports of a host, on which other robots may have their pages.
        port = listener.getsockname()[1]
        cookie = SESSION_COOKIE if public.origin else f"{SESSION_COOKIE}_{port}"
        self._gate = Gate(behind, access, connections, public, self._identity, cookie)
        outside = with_forwarded(self._gate, station.settings.trusted_proxies)
        self._server = PageServer(outside, listener, connections)

    def _tell_team(self, team: OtherRobots) -> None:
        """Let pages stop all robots, and tell the others how this one is."""
        stop, module = self._emergency_stop, self._module
        stop.service.team = StopAll(stop.requests, lambda: stop.state_text, team)
        self._teller = SummaryTeller(
            self._context, team, self._strip, self._identity, lambda: module.page_address, module.publish
        )

    def _parts(self, titled: Sequence[tuple[Panel, str]]) -> PageParts:
        station, strip = self._context, self._strip
        control = ControlBar(station.messages, station.operators)
        playback = PlaybackBar(station.messages, [kind for one in self._panels for kind in one.log_events])
        alarms = AlarmBar(strip.alarms)
        marker = MomentMarker(station.clock, station.log)
        record = RecordButton(station.run.recorder)
        snapshot = SnapshotButton(
            Snapshots(station.run.output_directory, station.robot.cameras, station.robot.births)
        )
        style, is_ours = first_paint.serve(), first_paint.are_ours(map(type, self._panels))
        below = [panel.build_below_tiles for panel in self._panels]
        past = station.settings.past_of
        if past or self._module.log_source:
            banner = PastBanner(past.get("title", "")) if past else LogBanner(station.messages)
            return PageParts(
                driver=None,
                strip=strip.build,
                tools=[self._emergency_stop.build],
                bars=[banner.build],
                foot=[playback.build],
                panels=titled,
                plays_log=lambda: playback.has_log,
                first_paint=style,
                is_ours=is_ours,
                identity=self._identity,
                stop_path=past.get("path", "") if past else None,
            )
        return PageParts(
            driver=lambda page: Driver(station, page, self._module.publish),
            strip=strip.build,
            tools=[record.build, snapshot.build, marker.build, self._emergency_stop.build],
            bars=[
                control.build,
                alarms.build,
                *(panel.build_on_every_tab for panel in self._panels),
            ],
            foot=[*below, playback.build, control.add_keys],
            panels=titled,
            plays_log=lambda: playback.has_log,
            first_paint=style,
            is_ours=is_ours,
            identity=self._identity,
        )

    def _add_pages(self, parts: PageParts, layouts: LayoutCollection) -> None:
        names = {panel.name for panel, _ in parts.panels}

        def build(panel: str = "") -> None:
            if panel and panel not in names:
                raise HTTPException(404)
            build_page(self._open_page(), parts, layouts, single=panel)

        for path in ("/", f"{TILE_PATH}{{panel}}"):
            ui.page(path, title=self._identity.name, response_timeout=10)(build)

    def _open_page(self) -> Page:
        client, operators = ui.context.client, self._context.operators
        session, link = client.request.scope[SESSION], BrowserLink(core.sio, client.id)
        page = Page(client.id, session, self._access, self._module, link)
        page.shows_past = bool(self._context.settings.past_of)
        page.plays_log = bool(self._module.log_source)
        operators.opened(page)
        client.on_delete(lambda: operators.closed(page))
        return page

    def _beside_pages(self, pages: App) -> App:
        """Return an application that serves the pages, which are limited, and their own connections."""
        open_pages = self._context.operators.pages
        PageEvents(open_pages, self._access.refusals)
        cameras = self._context.robot.cameras.pictures
        live = with_live(with_known_packets(pages), self._context.live, cameras, self._streams, open_pages)
        return with_page_limit(self._emergency_stop.service.beside(live), self._access, open_pages)

    @property
    def open_pages(self) -> int:
        """Number of open pages."""
        return len(self._context.operators.pages)

    @property
    def foreign_requests(self) -> int:
        """Number of requests that were refused because they came from pages of other sites."""
        return self._gate.foreign

    @property
    def failed_videos(self) -> int:
        """How often a picture could not be encoded here, or decoded by a page."""
        return self._streams.failures

    def start(self) -> None:
        """Start the server.

        Raises:
            ServerFailed: the server does not start.
        """
        self._server.start()

    def tick(self) -> None:
        """Check the page server, and do the work that is common to all pages.

        Raises:
            ServerFailed: the server has ended.
        """
        self._server.check()
        self._emergency_stop.tick()
        self._context.run.player.tick()
        self._context.run.recorder.tick()
        self._map.tick()
        self._context.robot.motion.tick()
        self._context.robot.floor.tick()
        self._strip.tick()
        for panel in self._panels:
            panel.tick()
        team = self._context.team
        if team is not None and self._teller is not None:
            team.tick()
            self._teller.tick()
        if self.open_pages or team is not None:
            self._context.run.figures.tick()
            if (reading := self._context.run.figures.reading) is not None:
                self._context.robot.cameras.tick(reading.channels)

    def close(self) -> None:
        """Tell the pages that the station ends, stop the page server, and close the panels."""
        self._emergency_stop.service.end()
        self._server.close()
        self._context.run.player.close()
        self._context.run.recorder.close()
        if self._teller is not None:
            self._teller.close()
        for panel in self._panels:
            panel.close()
        self._context.run.figures.close()
