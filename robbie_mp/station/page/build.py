"""The page as a whole: the bar at the top, and a tile for each panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import nicegui
from nicegui import Client, ui

from robbie_mp.station.page import first_paint
from robbie_mp.station.page.cockpit import LAYOUT, TAB, Cockpit
from robbie_mp.station.page.grid import STYLES
from robbie_mp.station.page.identity import ANY_ROBOT, Identity
from robbie_mp.station.page.keyboard import Keyboard, keys_button
from robbie_mp.station.page.layouts import LayoutCollection
from robbie_mp.station.page.look import COOKIE, LookSwitch
from robbie_mp.station.page.page import Drives, Page, PageLink
from robbie_mp.station.panel import Panel
from robbie_mp.station.web.access import Role

PRIMARY = "#00796b"
"""Colour of what can be pressed. White text on it has a contrast of 5.3."""
POSITIVE, NEGATIVE = "#2e7d32", "#c62828"
"""Colours of notes. White text on them has contrasts of 5.1 and 5.6."""
STYLE = Path(__file__).parent / "cockpit.css"
SCRIPTS = [Path(__file__).parent / name for name in ("awake.js", "list_boxes.js", "show_on_map.js")]
LOG_OUT = """() => fetch(`${window.stop_prefix}/logout`, {method: 'POST'})
  .then(() => window.location.assign(`${window.stop_prefix}/login`))"""
RECONNECT = "window.socket.io.reconnectionDelay(100); window.socket.io.reconnectionDelayMax(500)"
"""Try to reconnect every few tenths of a second (Socket.IO's default is up to 5 s)."""
BEGIN = """<script>
window.path_prefix = "{prefix}"; // as NiceGUI does later
// Opens the connection of groups of live parts, or of the video (live/server.py).
window.open_live = (groups) => {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  return new WebSocket(`${scheme}//${location.host}${window.path_prefix}/live/${groups}?page={key}`);
};
window.stop_prefix = "{stop_prefix}"; // of the robot's own page, also on a page that shows the past
const browser_path = decodeURI(location.pathname), own_path = "{path}";
if (browser_path !== window.path_prefix + own_path && browser_path.endsWith(own_path))
  location.replace(browser_path.slice(0, -own_path.length) + "/login"); // which tells what is wrong
// Asks the server without a WebSocket. Returns the status of its answer, and its text if it refuses the page.
window.ask_server = async () => {
  const question = { method: "POST", headers: { Accept: "text/plain" }, signal: AbortSignal.timeout(3000) };
  const answer = await fetch(`${window.stop_prefix}/emergency-stop`, question).catch(() => null);
  return { status: answer?.status, refusal: answer?.status === 403 ? await answer.text() : "" };
};
</script>"""
"""Let scripts know where the page is served, and leave a page whose address a proxy has changed."""
LOAD_AGAIN = """<script>
addEventListener("error", ({ target }) => {
  if (!["SCRIPT", "LINK"].includes(target.tagName)) return;
  setTimeout(async () => {
    if (document.getElementById("app")?.childElementCount) return;
    const { refusal } = await window.ask_server();
    if (!refusal) return location.reload();
    const note = Object.assign(document.createElement("main"), { id: "link-refused", textContent: refusal });
    note.style.whiteSpace = "pre-line";
    document.body.replaceChildren(note);
  }, 1000);
}, true);
</script>"""
"""Load a page again that stays empty because its network has lost a script, or say that it is refused."""
LARGE_SCRIPTS = ("quasar.umd.prod.js",)
PURIFIER = "dompurify.mjs"
"""The module that NiceGUI imports before it shows anything, but names last."""
MAX_WAITING_PACKETS = 4
"""Maximum number of packets that wait for a browser. With this many waiting, its page is not updated."""
NAMESPACE = "/"
ENDS_PERIOD_S = 0.2
"""Time between two looks whether what the operator asked for has ended."""


class BrowserLink(PageLink):
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


@dataclass(frozen=True)
class PageParts:
    """The builders of the parts of a page."""

    driver: Callable[[Page], Drives] | None
    """Builds what drives for an operator's page; None: nothing does."""
    strip: Callable[[Page], None]
    """Builds the strip with the state of the robot."""
    tools: Sequence[Callable[[Page], None]]
    """Build the buttons in the bar at the top."""
    bars: Sequence[Callable[[Page], None]]
    """Build the elements above the tiles, some of them hidden most of the time."""
    foot: Sequence[Callable[[Page], None]]
    """Build the bars below the tiles, most of them hidden most of the time."""
    panels: Sequence[tuple[Panel, str]]
    """Each with its title."""
    plays_log: Callable[[], bool]
    """Returns whether a log plays."""
    first_paint: str
    """The path of the file with the icons and styles that the page needs first."""
    is_ours: bool
    """Whether that file has all that the panels use."""
    identity: Identity = ANY_ROBOT
    """The robot's name and colour."""
    stop_path: str | None = None
    """Of a page that shows the past, the path of the live page, whose robot its emergency stop stops."""


def build_page(page: Page, parts: PageParts, layouts: LayoutCollection, single: str = "") -> None:
    """Build the elements of a page that has just been opened.

    Args:
        page: the page.
        parts: build the page's parts.
        layouts: the layouts of the panels.
        single: the only panel that the page shows; '': it has layouts.
    """
    client = ui.context.client
    _add_head(client, parts)
    ui.run_javascript(RECONNECT)
    for style in (*STYLES, STYLE):
        ui.add_css(style)
    ui.colors(primary=PRIMARY, positive=POSITIVE, negative=NEGATIVE)
    if page.role is Role.OPERATOR and parts.driver is not None:
        page.driver = parts.driver(page)
    cockpit = Cockpit(page, layouts, parts.panels, single, parts.plays_log)
    with ui.element("div").classes("cockpit"):
        with ui.element("header").classes("cockpit-bar beside-emergency-stop"):
            _build_name(parts.identity)
            parts.strip(page)
            with ui.element("div").classes("cockpit-tools"):
                _build_tools(page, parts, cockpit)
        with ui.element("div").classes("cockpit-bars"):
            for build in parts.bars:
                build(page)
        asked = client.request.query_params if client.request else {}
        cockpit.build(asked.get(LAYOUT, ""), asked.get(TAB, ""))
        with ui.element("footer").classes("cockpit-foot"):
            for build in parts.foot:
                build(page)
    _add_keys(page, cockpit)
    Keyboard(page.keys)
    page.always(ENDS_PERIOD_S, page.show_ends)


def _add_head(client: Client, parts: PageParts) -> None:
    if client.request is not None:
        prefix, path = client.request.scope.get("root_path", ""), client.request.scope["path"]
        own_path = path[len(prefix) :]
        stop_prefix = prefix if parts.stop_path is None else parts.stop_path.rstrip("/")
        begin = BEGIN.replace("{prefix}", prefix).replace("{path}", own_path).replace("{key}", client.id)
        ui.add_head_html(early(prefix) + first_paint.head(prefix, parts.first_paint, is_all=parts.is_ours))
        ui.add_head_html(begin.replace("{stop_prefix}", stop_prefix))
    scripts = "".join(file.read_text() for file in SCRIPTS)
    ui.add_head_html(f"{LOAD_AGAIN}<script>{scripts}</script>")


def early(prefix: str) -> str:
    """Return links for the largest scripts, which load while many small ones wait for round trips."""
    root = f"{prefix}/_nicegui/{nicegui.__version__}/static"
    links = [f'<link rel="preload" as="script" href="{root}/{name}">' for name in LARGE_SCRIPTS]
    links.append(f'<link rel="modulepreload" href="{root}/{PURIFIER}">')
    return "".join(links)


def _build_name(identity: Identity) -> None:
    name = ui.label(identity.name).props("id=robot-name")
    name.props["title"] = identity.name
    name.style(f"border-left-color: {identity.colour}")


def _build_tools(page: Page, parts: PageParts, cockpit: Cockpit) -> None:
    cockpit.build_menu()
    keys_button()
    cookies = ui.context.client.request.cookies if ui.context.client.request else {}
    LookSwitch(cookies.get(COOKIE, "")).build(page)
    for build in parts.tools:
        build(page)
    role = (page.role or Role.OBSERVER).name.lower()
    ui.badge(role).props("outline id=role color=white").classes(f"is-{role}")
    leave = ui.button(icon="logout").on("click", js_handler=LOG_OUT)
    leave.props('flat dense color=white id=log-out aria-label="Log out" title="Log out"')


def _add_keys(page: Page, cockpit: Cockpit) -> None:
    """Add the keys of layouts and driving."""
    for number, name in enumerate(cockpit.names[:9], 1):
        page.add_key(f"{number}", f"Layout {name}", partial(cockpit.choose, name))
    if cockpit.names:
        page.add_key("0", "Back to the layout from a maximised tile", cockpit.show_all)
    if (driver := page.driver) is not None:
        page.add_key("+", "Drive faster", lambda: driver.change_limits(up=True))
        page.add_key("-", "Drive slower", lambda: driver.change_limits(up=False))
        page.add_key("t", "Take over driving from another page or operator", driver.take_over)
