"""Plots numbers in any messages over time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.attached.views.known_types import types_of_run
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.charts import ChartHistory, chart_options, fill
from robbie_mp.station.panels.numeric_fields import number_reader, numeric_paths
from robbie_mp.station.watch.latest import Latest, MessageSource
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

PERIOD_S = 0.5
SPACING_S = 0.1
HISTORY = 600
"""Number of values of a line: those of one minute at the highest stored rate."""
MAX_LINES = 8
"""Maximum number of lines on a page."""
MAX_KEPT = 16
"""Maximum number of lines that are kept although no page shows them."""
Key = tuple[str, str]
"""Name of the messages in this panel, and path of the number: what an operator chooses."""
FIRST: tuple[Key, ...] = (
    ("odom: nav_msgs/Odometry", "twist.twist.linear.x"),
    ("odom: nav_msgs/Odometry", "twist.twist.angular.z"),
)
"""What pages show until an operator has chosen something: the robot's speed and turn rate."""


class PlotsPanel(Panel):
    """Shows charts of chosen numbers.

    A page that is opened later begins with what an operator has chosen last, and with the values of that.
    """

    name = "plots"
    title = "Plots"
    icon = "show_chart"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._messages, self._figures = station.messages, station.run.figures
        self._known = types_of_run(station.run.known)
        self._wishes: SimpleQueue[PlotLine] = SimpleQueue()
        self._lines: dict[Key, PlotLine] = {}
        self.chosen: tuple[Key, ...] = FIRST
        """What an operator has chosen last."""

    def tick(self) -> None:
        """Subscribe to the messages that pages have requested."""
        try:
            while True:
                line = self._wishes.get_nowait()
                try:
                    line.listen(self._messages.newest(line.message_type, line.topic))
                except RobbieError as error:
                    line.error = str(error)
        except Empty:
            pass

    def channels(self) -> dict[str, ChannelName]:
        """Return all published channels by their names in this panel; of several versions, the newest."""
        reading = self._figures.reading
        return {
            f"{channel.topic or '(no topic)'}: {channel.type_name.replace('/msg/', '/')}": ChannelName(
                channel.type_name, channel.version, channel.topic
            )
            for channel in sorted(reading.channels if reading else (), key=lambda one: one.version)
            if channel.messages
        }

    def type_of(self, channel: ChannelName) -> type[Message]:
        """Return the class of the messages of a channel, in the version that is published there.

        Raises:
            UnknownType, SchemaError: the type's description is unknown or invalid.
        """
        return self._known.get(channel.type_name, channel.version)

    def take(self, key: Key) -> PlotLine:
        """Return a line for a page to show; other pages may show it, too.

        Raises:
            RobbieError: there are no such messages, or no such number in them.
        """
        line = self._lines.pop(key, None)
        if line is None:
            channel = self.channels()[key[0]]
            line = PlotLine(self._messages, self.type_of(channel), channel.topic, key[1])
            self._wishes.put(line)
        self._lines[key] = line
        line.pages += 1
        return line

    def give_back(self, line: PlotLine) -> None:
        """Note that a page shows a line no more. Close the lines that no page has shown for longest."""
        line.pages -= 1
        unused = [key for key, one in self._lines.items() if not one.pages]
        for key in unused[: max(0, len(unused) - MAX_KEPT)]:
            self._lines.pop(key).close()

    def build(self, page: Page) -> None:
        """Build the choice of fields, and the chart."""
        chart = PageChart(self, chooses=page.role is Role.OPERATOR)
        page.every(PERIOD_S, self.name, chart.update)
        ui.context.client.on_delete(chart.close)


class PlotLine:
    """One number over time.

    Args:
        messages: knows the topic of the message that is being handled.
        message_type, topic: the messages.
        path: path of the number.

    Raises:
        NoSuchNumber: there is no such number.
    """

    def __init__(self, messages: MessageSource, message_type: type[Message], topic: str, path: str):
        self.message_type, self.topic = message_type, topic
        self.name = f"{topic or message_type.__name__}.{path}"
        self.pages = 0
        """Number of pages that show it."""
        self.history = ChartHistory(HISTORY)
        self.newest: float | None = None
        self.error = ""
        self._messages = messages
        self._read = number_reader(message_type, path)
        self._kept_s = 0.0
        self._source: Latest[Message] | None = None
        self._is_closed = False

    def listen(self, source: Latest[Message]) -> None:
        """Subscribe and take values from now on; called in the module's thread."""
        if not self._is_closed:
            self._source = source
            source.listen(self._take)

    def _take(self, message: Message) -> None:
        if self._is_closed and self._source is not None:
            self._source.ignore(self._take)
            return
        if self._messages.envelope.topic != self.topic:
            return  # a subscription without a topic gets the messages of all topics
        value, now_s = self._read(message), time.time()
        self.newest = value
        if value is not None and not 0 <= now_s - self._kept_s < SPACING_S:
            self._kept_s = now_s
            self.history.add(now_s, value)

    def close(self) -> None:
        """Stop taking values. Any thread may call this."""
        self._is_closed = True

    @property
    def text(self) -> str:
        """Name and newest value of the line, or its error."""
        return (
            f"{self.name}: {self.error or ('no value yet' if self.newest is None else f'{self.newest:.6g}')}"
        )


class SuggestedField:
    """A text field with suggestions that the browser shows.

    Args:
        label: label of the field.
        name: name of the element.
        on_change: called when the choice has changed.
    """

    def __init__(self, label: str, name: str, on_change: Callable[[], None] | None = None):
        self.input = ui.input(label, on_change=on_change).classes("plot-choice")
        self.input.props(f"for={name} list={name}-offered debounce=0 dense")
        self._offered = ui.element("datalist").props(f"id={name}-offered")

    @property
    def text(self) -> str:
        """The chosen text."""
        return str(self.input.value).strip()

    def offer(self, texts: Iterable[str]) -> None:
        """Set the suggestions."""
        self._offered.clear()
        with self._offered:
            for text in texts:
                ui.element("option").props["value"] = text


class PageChart:
    """The lines of one page, and the fields to choose them.

    Args:
        panel: source of the values.
        chooses: whether pages that are opened later begin with what is chosen here.
    """

    def __init__(self, panel: PlotsPanel, *, chooses: bool):
        self._panel = panel
        self._chooses = chooses
        self._lines: dict[Key, tuple[PlotLine, ui.label]] = {}
        self._waiting = [*panel.chosen]
        """What is shown as soon as it is published."""
        self._offered: list[str] = []
        with ui.row().classes("items-start w-full"):
            self._channel = SuggestedField("messages", "plot-channel", self._offer_fields)
            self._path = SuggestedField("field, such as ranges[90]", "plot-field")
            ui.button("Plot", on_click=self._add).props("id=plot-add").classes("q-mt-sm")
        self._list = ui.column().classes("gap-0").props("id=plot-lines")
        self._place = ui.column().classes("w-full fills")
        self._chart: ui.echart | None = None

    def update(self) -> None:
        """Show the newest values, and suggest newly published channels."""
        if self._chart is None:  # its library is a large part of the page
            with self._place:
                self._chart = ui.echart(chart_options([]), renderer="svg").classes("w-full fills")
            self._draw_anew()
        offered = sorted(self._panel.channels())
        if offered != self._offered:
            self._offered = offered
            self._channel.offer(offered)
        for key in [key for key in self._waiting if key[0] in offered]:
            self._waiting.remove(key)
            with suppress(RobbieError):  # the type has changed since it was chosen
                self._show(key)
        for line, label in self._lines.values():
            label.set_text(line.text)
        if self._lines:
            self._fill()

    def close(self) -> None:
        """Give all lines back."""
        for line, _ in self._lines.values():
            self._panel.give_back(line)

    def _offer_fields(self) -> None:
        chosen = self._chosen()
        self._path.offer(numeric_paths(chosen) if chosen else [])

    def _chosen(self) -> type[Message] | None:
        """Return the type of the chosen messages; if there are none, show an error and return None."""
        found = self._panel.channels().get(self._channel.text)
        try:
            chosen = self._panel.type_of(found) if found else None
            self._channel.input.error = None if chosen else "nobody publishes this"
        except RobbieError as error:
            chosen, self._channel.input.error = None, str(error)
        return chosen

    def _add(self) -> None:
        if self._chosen() is None:
            return
        key = (self._channel.text, self._path.text)
        self._path.input.error = None
        if key in self._lines:
            self._path.input.error = "it is there already"
            return
        if len(self._lines) >= MAX_LINES:
            self._path.input.error = f"at most {MAX_LINES} lines; remove one first"
            return
        try:
            self._show(key)
        except RobbieError as error:
            self._path.input.error = str(error)
            return
        self._keep()

    def _show(self, key: Key) -> None:
        line = self._panel.take(key)
        with self._list, ui.row().classes("items-center") as row:
            label = ui.label(line.text)
            ui.button(icon="close", on_click=lambda: self._remove(key, row)).props(
                "flat dense aria-label=remove"
            )
        self._lines[key] = (line, label)
        self._draw_anew()

    def _remove(self, key: Key, row: ui.row) -> None:
        line, _ = self._lines.pop(key)
        self._panel.give_back(line)
        row.delete()
        self._draw_anew()
        self._keep()

    def _keep(self) -> None:
        """Let pages that are opened later begin with what this one shows."""
        if self._chooses:
            self._panel.chosen = (*self._lines, *self._waiting)

    def _draw_anew(self) -> None:
        if self._chart is None:
            return
        self._chart.options.update(chart_options(line.name for line, _ in self._lines.values()))
        self._fill()

    def _fill(self) -> None:
        if self._chart is None:
            return
        fill(self._chart.options, {line.name: line.history for line, _ in self._lines.values()})
