"""The topics with their rates, the newest message of one of them, and a form to send one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import run, ui

from robbie_mp.attached.views.known_types import types_of_run
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel, columns
from robbie_mp.station.panels.message_form import MessageForm
from robbie_mp.station.watch.run import REFRESH_S
from robbie_mp.station.watch.topic import TopicWatch
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

TREE_REFRESH_S = 0.5
MAX_WATCHES = 4
"""Maximum number of topics that all pages together can show, because a run allows few tools."""


class MessagesPanel(Panel):
    """Shows a table of topics, a tree of fields, and a form."""

    name = "messages"
    title = "Messages"
    icon = "forum"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._run, self._log, settings = station.run, station.log, station.settings
        self._words = [*settings.persons, *settings.objects, *settings.speech_commands]
        self.types = types_of_run(station.run.known)
        self.watches: dict[str, TopicWatch] = {}
        """Watched topics by the key of the page."""

    def tick(self) -> None:
        """Stop watching topics that no page shows any more."""
        for key in list(self.watches):
            page = self._pages.get(key)
            if page is None or self.name not in page.shown:
                self.watches.pop(key).close()

    def close(self) -> None:
        """Stop watching all topics."""
        for watch in self.watches.values():
            watch.close()

    def build(self, page: Page) -> None:
        """Build the three parts."""
        with ui.element("div").classes("messages-parts fills"):
            table = ui.table(
                columns=columns("type", "topic", "version", "messages", "Hz", "kB/s"), rows=[], row_key="key"
            )
            table.props("dense flat id=messages-topics")
            with ui.column().classes("messages-message no-wrap").props("tabindex=0"):
                title = ui.label("Press on a line to look into its newest message")
                title.props("id=messages-chosen")
                tree = ui.tree([], label_key="label").props("dense id=messages-tree")
                tree.set_visibility(False)
                if page.role is Role.OPERATOR:
                    form = ui.expansion("Compose a message", icon="send").classes("w-full")
                    with form.props("id=messages-compose"):
                        MessageForm(self._words, self._log, self.types, self.version_of, page)
        view = MessageView(self, page, title, tree)
        table.on("row-click", view.choose, js_handler="(event, row) => emit(row.key)")

        def update() -> None:
            table.rows = self.rows()

        page.every(REFRESH_S / 2, self.name, update)
        page.every(TREE_REFRESH_S, self.name, view.update)

    def rows(self) -> list[dict[str, Any]]:
        """Return a table row for each channel."""
        reading, rates = self._run.figures.reading, self._run.figures.rates
        found = []
        for channel in reading.channels if reading else ():
            key = (channel.type_name, channel.version, channel.topic)
            rate = rates.channels.get(key) if rates else None
            found.append(
                {
                    "key": "\n".join(map(str, key)),
                    "type": channel.type_name,
                    "topic": channel.topic,
                    "version": channel.version,
                    "messages": channel.messages,
                    "Hz": f"{rate.hz:.1f}" if rate else "",
                    "kB/s": f"{rate.bytes_per_s / 1000:.1f}" if rate else "",
                }
            )
        return found

    def version_of(self, type_name: str, topic: str) -> int | None:
        """Return in which version a type is published on a topic, the newest of several; None: it is not."""
        reading = self._run.figures.reading
        return max(
            (
                one.version
                for one in (reading.channels if reading else ())
                if (one.type_name, one.topic) == (type_name, topic) and one.messages
            ),
            default=None,
        )

    def watch(self, key: str, channel: ChannelName) -> str:
        """Let a page watch a channel. Return '', or the reason why it cannot."""
        if key in self.watches:
            self.watches.pop(key).close()
        if len(self.watches) >= MAX_WATCHES:
            return f"{MAX_WATCHES} other pages look into messages; more may not"
        self.watches[key] = TopicWatch(self._run.known, self.types, channel)
        return ""


class MessageView:
    """The newest message of the channel that one page has chosen."""

    def __init__(self, panel: MessagesPanel, page: Page, title: ui.label, tree: ui.tree):
        self._panel = panel
        self._page = page
        self._title = title
        self._tree = tree
        self._chosen: ChannelName | None = None
        self._shown = 0

    def choose(self, event: Any) -> None:
        """Watch another channel."""
        parts = str(event.args).split("\n")
        if len(parts) != 3 or not parts[1].isdigit():
            return
        self._chosen = ChannelName(parts[0], int(parts[1]), parts[2])
        self._shown = 0
        self._show([])
        self._look()

    def _look(self) -> None:
        if self._chosen is not None:
            problem = self._panel.watch(self._page.key, self._chosen)
            self._title.set_text(problem or f"waits for a {self._chosen.type_name} …")

    async def update(self) -> None:
        """Show the newest message, unless it is shown already. Another thread decodes it."""
        watch = self._panel.watches.get(self._page.key)
        if watch is None:
            self._look()  # the visitor has returned to this tab
            return
        received = watch.newest
        if watch.error:
            self._title.set_text(watch.error)
        if received is None or received.sequence == self._shown:
            return
        self._shown = received.sequence
        try:
            nodes = await run.io_bound(watch.tree, received)
        except RobbieError as error:
            self._title.set_text(f"cannot be read: {error}")
            return
        about = f", topic {received.topic}" if received.topic else ""
        self._title.set_text(
            f"{received.type_name}{about}, from {received.sender}, number {received.sequence}, "
            f"{len(received.data)} bytes"
        )
        self._show(nodes or [])

    def _show(self, nodes: list[dict[str, Any]]) -> None:
        self._tree.set_visibility(bool(nodes))
        self._tree.props["nodes"] = nodes
        self._tree.update()
