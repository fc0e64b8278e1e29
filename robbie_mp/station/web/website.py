"""The application that serves the page. Needs the extra `gui`."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING

from fastapi import FastAPI, Request
from nicegui import app, core, ui
from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse, Response

from robbie_mp.run.trace.log_limit import limited
from robbie_mp.station.driving.command import RobotCommand
from robbie_mp.station.driving.motion import Motion
from robbie_mp.station.live.map import LiveMap
from robbie_mp.station.live.server import with_live
from robbie_mp.station.page.cockpit import TILE_PATH
from robbie_mp.station.page.layouts import LayoutCollection, check_layout, default_layouts
from robbie_mp.station.page.moment_marker import MomentMarker
from robbie_mp.station.page.page import PageParts, build_page
from robbie_mp.station.page.playback_bar import PlaybackBar
from robbie_mp.station.page.state_strip import StateStrip
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS, load_panels, panels_in_order
from robbie_mp.station.stop.emergency_stop import EmergencyStopControl
from robbie_mp.station.watch.cameras import Cameras
from robbie_mp.station.watch.lights import LightsWatch
from robbie_mp.station.web.connections import bounded_connections
from robbie_mp.station.web.gate import Gate
from robbie_mp.station.web.page_events import PageEvents, with_known_packets
from robbie_mp.station.web.page_limit import with_page_limit
from robbie_mp.station.web.server import PageServer

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.panel import Panel

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


def make_panels(station: StationContext) -> tuple[dict[str, Panel], dict[str, str]]:
    """Create the panels of a station.

    Returns:
        The panels by name, and the names and titles of the tabs in their order. The robot's own panels are
        created even if no tab shows them, because they may have elements on every tab and on the map.
    """
    own = load_panels(station.panels)
    classes = panels_in_order(own)
    wanted = [name for name, panel in classes.items() if panel.is_wanted(station)]
    titles = station.tabs or dict.fromkeys(wanted, "")
    return {name: panel(station) for name, panel in classes.items() if name in titles or name in own}, titles


def layouts_of(station: StationContext, panels: Sequence[str]) -> LayoutCollection:
    """Return the layouts of a station: those of its profile, and its own for which the profile has no other.

    Args:
        station: the station.
        panels: names of the panels in the order of their tabs.
    """
    own = [name for name in panels if name not in FRAMEWORK_PANELS]
    given = {name: check_layout(name, places, panels) for name, places in station.layouts.items()}
    layouts = {name: layout for name, layout in (default_layouts(panels, own) | given).items() if layout}
    upright = default_layouts(panels, own, upright=True)
    upright = {name: layout for name, layout in upright.items() if name not in given}
    file = station.layouts_file or station.known_run.folder / LAYOUTS_FILE
    return LayoutCollection(layouts, panels, file, station.log, upright)


class Website:
    """The page of a station and its server.

    Args:
        station: the module, which is just being set up.
        listener: the socket on which the station listens.
    """

    def __init__(self, station: StationContext, listener: socket.socket):
        self._map = LiveMap(station)
        station.robot_command = RobotCommand(
            station, lambda request, topic: station.publish(request, topic=topic)
        )
        self._motion = station.motion = Motion(station)
        station.cameras = Cameras(station)
        station.lights = LightsWatch(station)
        panels, titles = make_panels(station)
        self._panels = [*panels.values()]
        self._strip = StateStrip(station, self._panels)
        titled = [(panels[name], title or panels[name].title) for name, title in titles.items()]
        self._emergency_stop = EmergencyStopControl(station)
        tools = [self._strip.control.build, MomentMarker(station).build, self._emergency_stop.build]
        event_kinds = [kind for panel in self._panels for kind in panel.log_events]
        playback_bar = PlaybackBar(station, event_kinds)
        bars = [panel.build_on_every_tab for panel in self._panels]
        foot = [*(panel.build_below_tiles for panel in self._panels), playback_bar.build]
        foot.append(self._strip.control.add_keys)
        parts = PageParts(self._strip.build, tools, bars, foot, titled, lambda: playback_bar.has_log)
        layouts = layouts_of(station, [name for name in titles if name in panels])

        def build(panel: str = "") -> None:
            if panel and panel not in titles:
                raise HTTPException(404)
            build_page(station, parts, layouts, single=panel)

        for path in ("/", f"{TILE_PATH}{{panel}}"):
            ui.page(path, title="Robbie", response_timeout=10)(build)
        application = FastAPI(openapi_url=None)
        ui.run_with(
            application,
            dark=True,
            language="en-US",
            reconnect_timeout=10.0,
            binding_refresh_interval=None,
            message_history_length=MESSAGE_HISTORY,
            show_welcome_message=False,
        )
        # The page fetches images all the time; a bar that shows each of them loading tells nothing.
        core.app.config.quasar_config["loadingBar"]["skipHijack"] = True
        PageEvents(station)
        # Without long polling, each connection is a socket, which is counted, and closed with its session.
        core.sio.eio.transports = ["websocket"]
        core.app.config.socket_io_js_transports = ["websocket"]
        for code in (404, 500):
            app.add_exception_handler(code, answer_plainly)
        for name in LIBRARIES:
            limited(name)
        live = self._emergency_stop.service.beside(with_live(with_known_packets(application), station.live))
        behind = with_page_limit(live, station)
        connections = bounded_connections()
        gate = Gate(behind, station.access, connections, station.refusals)
        self._server = PageServer(gate, listener, connections)

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
        self._map.tick()
        self._motion.tick()
        self._strip.tick()
        for panel in self._panels:
            panel.tick()

    def close(self) -> None:
        """Tell the pages that the station ends, stop the page server, and close the panels."""
        self._emergency_stop.service.end()
        self._server.close()
        for panel in self._panels:
            panel.close()
