"""The page as a whole: the bar at the top, and a tile for each panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import core, ui

from robbie_mp.station.access import Role
from robbie_mp.station.cockpit import LAYOUT, TAB, Cockpit
from robbie_mp.station.context import Link, Page
from robbie_mp.station.gate import SESSION
from robbie_mp.station.grid import STYLES
from robbie_mp.station.layouts import LayoutCollection
from robbie_mp.station.panel import Panel

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

PRIMARY = "#00796b"
"""Colour of what can be pressed. White text on it has a contrast of 5.3."""
STYLE = Path(__file__).parent / "cockpit.css"
LOG_OUT = "() => fetch('/logout', {method: 'POST'}).then(() => window.location.assign('/login'))"
RECONNECT = "window.socket.io.reconnectionDelay(100); window.socket.io.reconnectionDelayMax(500)"
"""Try to reconnect every few tenths of a second (Socket.IO's default is up to 5 s)."""
MAX_WAITING_PACKETS = 4
"""Maximum number of packets that wait for a browser. With this many waiting, its page is not updated."""
NAMESPACE = "/"
ENDS_PERIOD_S = 0.2
"""Time between two looks whether what the operator asked for has ended."""


class BrowserLink(Link):
    """Counts the packets that wait for one browser.

    Socket.IO queues packets for a browser without a limit. So updates of a page check this first. A skipped
    update does no harm, because a later one has the newest state.

    Args:
        server: the socketio.AsyncServer that sends to all browsers.
        client: the browser.
    """

    def __init__(self, server: Any, client: str):
        self._server = server
        self._client = client

    @property
    def is_free(self) -> bool:
        """Whether there is a connection, and few packets wait for it."""
        waiting = [
            found.queue.qsize()
            for _, connection in self._server.manager.get_participants(NAMESPACE, self._client)
            if (found := self._server.eio.sockets.get(connection)) is not None
        ]
        # A browser that has reconnected may still have its former connection, too.
        return bool(waiting) and min(waiting) < MAX_WAITING_PACKETS


def build_page(
    station: StationContext,
    tools: Sequence[Callable[[Page], None]],
    bars: Sequence[Callable[[Page], None]],
    panels: Sequence[tuple[Panel, str]],
    layouts: LayoutCollection,
    single: str = "",
) -> None:
    """Build the elements of a page that has just been opened.

    Args:
        station: the station that serves the page.
        tools: build the elements in the bar at the top.
        bars: build the elements above the tiles, some of them hidden most of the time.
        panels: each with its title.
        layouts: the layouts of the panels.
        single: the only panel that the page shows; '': it has layouts.
    """
    client = ui.context.client
    page = Page(client.id, client.request.scope[SESSION], station, BrowserLink(core.sio, client.id))
    role = page.role or Role.OBSERVER
    station.opened(page)
    client.on_delete(lambda: station.closed(page))
    ui.run_javascript(RECONNECT)
    for style in (*STYLES, STYLE):
        ui.add_css(style)
    ui.colors(primary=PRIMARY)
    cockpit = Cockpit(page, layouts, panels, single)
    with ui.element("div").classes("cockpit"):
        with (
            ui.element("header").classes("cockpit-bar beside-emergency-stop"),
            ui.element("div").classes("cockpit-tools"),
        ):
            for build in tools:
                build(page)
            cockpit.build_menu()
            ui.badge(role.name.lower()).props("outline id=role color=white")
            leave = ui.button(icon="logout").on("click", js_handler=LOG_OUT)
            leave.props('flat dense color=white id=log-out aria-label="Log out" title="Log out"')
        with ui.element("div").classes("cockpit-bars"):
            for build in bars:
                build(page)
        asked = client.request.query_params if client.request else {}
        cockpit.build(asked.get(LAYOUT, ""), asked.get(TAB, ""))
    page.always(ENDS_PERIOD_S, page.show_ends)
