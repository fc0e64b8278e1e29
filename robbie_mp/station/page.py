"""The page as a whole: the bar at the top, and a tab for each panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from nicegui import core, ui

from robbie_mp.station.access import Role
from robbie_mp.station.context import Link, Page
from robbie_mp.station.gate import SESSION
from robbie_mp.station.panel import Panel

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

TAB = "tab"
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
) -> None:
    """Build the elements of a page that has just been opened.

    Args:
        station: the station that serves the page.
        tools: build the elements in the bar at the top.
        bars: build the elements above the tabs, some of them hidden most of the time.
        panels: each with its title.
    """
    client = ui.context.client
    page = Page(client.id, client.request.scope[SESSION], station, BrowserLink(core.sio, client.id))
    role = page.role or Role.OBSERVER
    station.opened(page)
    client.on_delete(lambda: station.closed(page))
    ui.run_javascript(RECONNECT)
    with ui.header().classes("items-center q-py-xs beside-emergency-stop"):
        ui.label(f"Robbie · {station.run_id}").classes("text-lg")
        ui.badge(role.name.lower()).props("outline id=role color=white")
        leave = ui.button(icon="logout").on("click", js_handler=LOG_OUT)
        leave.props('flat dense color=white id=log-out aria-label="Log out" title="Log out"')
        ui.space()
        for build in tools:
            build(page)
    for build in bars:
        build(page)
    with ui.tabs().classes("w-full") as tabs:
        made = {
            panel.name: ui.tab(panel.name, title, panel.icon).props(f"id=tab-{panel.name}")
            for panel, title in panels
        }
    asked = client.request.query_params.get(TAB) if client.request else None
    first = page.tab = asked if asked in made else next(iter(made))
    with ui.tab_panels(tabs, value=first, animated=False, keep_alive=True).classes("w-full"):
        for panel, _ in panels:
            with ui.tab_panel(panel.name).props(f"id=panel-{panel.name}"):
                panel.build(page)

    def turn_to(name: str) -> None:
        page.tab = name
        ui.navigate.history.replace(f"?{TAB}={name}")  # for a reload of the page

    tabs.on_value_change(lambda event: turn_to(str(event.value)))
    page.always(ENDS_PERIOD_S, page.show_ends)
