"""Plots numbers in any messages over time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.errors import RobbieError
from robbie_mp.messages import Message
from robbie_mp.station.charts import History, chart_options, fill
from robbie_mp.station.context import Page
from robbie_mp.station.latest import Latest
from robbie_mp.station.numeric_fields import number_reader, numeric_paths
from robbie_mp.station.panel import Panel
from robbie_mp.views.known_types import types_of_run

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

PERIOD_S = 0.5
SPACING_S = 0.1
HISTORY = 600
"""Number of values of a line: those of one minute at the highest stored rate."""
MAX_LINES = 8
"""Maximum number of lines on a page."""


class PlotsPanel(Panel):
    """Shows charts of chosen numbers."""

    name = "plots"
    title = "Plots"
    icon = "show_chart"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._known = types_of_run(station.known_run)
        self._wishes: SimpleQueue[Line] = SimpleQueue()

    def tick(self) -> None:
        """Subscribe to the messages that pages have requested."""
        try:
            while True:
                line = self._wishes.get_nowait()
                try:
                    line.listen(self.station.newest(line.message_type, line.topic))
                except RobbieError as error:
                    line.error = str(error)
        except Empty:
            pass

    def channels(self) -> dict[str, tuple[str, str]]:
        """Return type and topic of all published channels, by their names in this panel."""
        reading = self.station.run_watch.reading
        return {
            f"{channel.topic or '(no topic)'}: {channel.type_name.replace('/msg/', '/')}": (
                channel.type_name,
                channel.topic,
            )
            for channel in (reading.channels if reading else ())
            if channel.messages
        }

    def type_of(self, name: str) -> type[Message]:
        """Return a type's class.

        Raises:
            UnknownType, SchemaError: the type's description is unknown or invalid.
        """
        return self._known.get(name)

    def wish(self, line: Line) -> None:
        """Request the values of a line. Any thread may call this."""
        self._wishes.put(line)

    def build(self, page: Page) -> None:
        """Build the choice of fields, and the chart."""
        chart = PageChart(self)
        page.every(PERIOD_S, self.name, chart.update)
        ui.context.client.on_delete(chart.close)


class Line:
    """One number over time.

    Args:
        message_type, topic: the messages.
        path: path of the number.

    Raises:
        NoSuchNumber: there is no such number.
    """

    def __init__(self, station: StationContext, message_type: type[Message], topic: str, path: str):
        self.message_type, self.topic = message_type, topic
        self.name = f"{topic or message_type.__name__}.{path}"
        self.history = History(HISTORY)
        self.newest: float | None = None
        self.error = ""
        self._station = station
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
        if self._station.envelope.topic != self.topic:
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


class Choice:
    """A text field with suggestions that the browser shows.

    Args:
        label: label of the field.
        name: name of the element.
        on_change: called when the choice has changed.
    """

    def __init__(self, label: str, name: str, on_change: Callable[[], None] | None = None):
        self.input = ui.input(label, on_change=on_change).classes("w-80")
        self.input.props(f"for={name} list={name}-offered debounce=0")
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
    """

    def __init__(self, panel: PlotsPanel):
        self._panel = panel
        self._lines: dict[Line, ui.label] = {}
        self._offered: list[str] = []
        with ui.row().classes("items-start"):
            self._channel = Choice("messages", "plot-channel", self._offer_fields)
            self._path = Choice("field, such as ranges[90]", "plot-field")
            ui.button("Plot", on_click=self._add).props("id=plot-add").classes("q-mt-sm")
        self._list = ui.column().classes("gap-0").props("id=plot-lines")
        self._chart = ui.echart(chart_options([]), renderer="svg").classes("w-full h-96")

    def update(self) -> None:
        """Show the newest values, and suggest newly published channels."""
        offered = sorted(self._panel.channels())
        if offered != self._offered:
            self._offered = offered
            self._channel.offer(offered)
        for line, label in self._lines.items():
            label.set_text(line.text)
        if self._lines:
            self._fill()

    def close(self) -> None:
        """Release all lines."""
        for line in self._lines:
            line.close()

    def _offer_fields(self) -> None:
        chosen = self._chosen()
        self._path.offer(numeric_paths(chosen[0]) if chosen else [])

    def _chosen(self) -> tuple[type[Message], str] | None:
        """Return type and topic of the chosen messages; if there are none, show an error and return None."""
        found = self._panel.channels().get(self._channel.text)
        try:
            chosen = (self._panel.type_of(found[0]), found[1]) if found else None
            self._channel.input.error = None if chosen else "nobody publishes this"
        except RobbieError as error:
            chosen, self._channel.input.error = None, str(error)
        return chosen

    def _add(self) -> None:
        chosen = self._chosen()
        if chosen is None:
            return
        self._path.input.error = None
        if len(self._lines) >= MAX_LINES:
            self._path.input.error = f"at most {MAX_LINES} lines; remove one first"
            return
        try:
            line = Line(self._panel.station, *chosen, self._path.text)
        except RobbieError as error:
            self._path.input.error = str(error)
            return
        self._add_line(line)

    def _add_line(self, line: Line) -> None:
        if any(line.name == other.name for other in self._lines):
            self._path.input.error = "it is there already"
            return
        with self._list, ui.row().classes("items-center") as row:
            self._lines[line] = ui.label(line.text)
            ui.button(icon="close", on_click=lambda: self._remove(line, row)).props(
                "flat dense aria-label=remove"
            )
        self._panel.wish(line)
        self._draw_anew()

    def _remove(self, line: Line, row: ui.row) -> None:
        line.close()
        del self._lines[line]
        row.delete()
        self._draw_anew()

    def _draw_anew(self) -> None:
        self._chart.options.update(chart_options(line.name for line in self._lines))
        self._fill()

    def _fill(self) -> None:
        fill(self._chart.options, {line.name: line.history for line in self._lines})
