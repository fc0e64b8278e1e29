"""Shows all processes, with the columns of `robbie top`, and the load of the machine."""

from __future__ import annotations

import json
import time
from collections import defaultdict, deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.attached.views.process_table import MODULE_COLUMNS, ModuleRow, module_rows, totals_line
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.charts import ChartHistory, chart_options, fill, sparkline
from robbie_mp.station.panels.supervisor_orders import ModuleOrder
from robbie_mp.station.watch.run import REFRESH_S
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

HISTORY = 300
"""Number of values in each chart, one per second."""
SPARKS = 12
LEAST_SCALE_PERCENT = 20.0
"""Minimum value of the highest bar of a sparkline. Otherwise it is the largest value."""
TREND = "cpu% lately"
CHOICE = """<q-checkbox dense v-model="props.selected" :aria-label="'Choose ' + props.row.module" />"""
"""In each row; Quasar's own checkbox has no name for programs that read the page aloud."""
GIGABYTE = 1e9
Row = dict[str, Any]


class SystemPanel(Panel):
    """The table of processes, and charts of processors and memory."""

    name = "system"
    title = "System"
    icon = "memory"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._figures, self.run_folder = station.run.figures, station.run.known.folder
        self.rows: list[Row] = []
        self.totals = ""
        self.processors: dict[str, ChartHistory] = {}
        self.memory = {name: ChartHistory(HISTORY) for name in ("memory", "shared memory")}
        self.count = 0
        self._trends: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=SPARKS))

    def tick(self) -> None:
        """Return the newest figures as rows."""
        watch = self._figures
        reading, rates = watch.reading, watch.rates
        if reading is None or watch.count == self.count:
            return
        now_s, machine = time.time(), reading.machine
        for core, percent in enumerate(rates.cpu_percent if rates else ()):
            self.processors.setdefault(f"cpu {core}", ChartHistory(HISTORY)).add(now_s, percent)
        used_bytes = machine.memory_total_bytes - machine.memory_available_bytes
        self.memory["memory"].add(now_s, used_bytes / GIGABYTE)
        self.memory["shared memory"].add(now_s, machine.shared_memory_used_bytes / GIGABYTE)
        self.totals = totals_line(reading, rates).plain
        self.rows = [self._described(row) for row in module_rows(reading, rates)]
        self.count = watch.count

    def _described(self, row: ModuleRow) -> Row:
        trend = self._trends[row.figures.name]
        if row.rates:
            trend.append(row.rates.cpu_percent)
        cells: Row = {column.heading: column.cell(row).plain for column in MODULE_COLUMNS}
        order = {column.heading: column.order(row) for column in MODULE_COLUMNS}
        cells[TREND] = sparkline(trend, max(LEAST_SCALE_PERCENT, *trend)) if trend else ""
        return cells | {"order": order | {TREND: sum(trend)}}

    def build(self, page: Page) -> None:
        """Build buttons, table and charts."""
        totals = ui.label().classes("font-mono").props("id=totals")
        orders = ModuleButtons(self, page) if page.role is Role.OPERATOR else None
        headings = [column.heading for column in MODULE_COLUMNS]
        headings.insert(headings.index("cpu%") + 1, TREND)
        texts = {column.heading for column in MODULE_COLUMNS if column.is_text}
        columns = [_column(heading, is_text=heading in texts) for heading in headings]
        table = ui.table(columns=columns, rows=[], row_key="module", selection="single" if orders else None)
        table.props("dense flat").classes("w-full")
        if orders:
            table.on_select(lambda event: orders.choose(event.selection))
            table.add_slot("body-selection", CHOICE)
        area = ui.row().classes("w-full no-wrap")
        charts: list[tuple[ui.echart, dict[str, ChartHistory]]] = []
        shown = 0

        def update() -> None:
            nonlocal shown
            if orders:
                orders.update()
            if self.count == shown:
                return
            shown = self.count
            totals.set_text(self.totals)
            table.rows = self.rows
            if not charts and self.processors:
                with area:
                    charts.append((_chart(self.processors, "%", 100.0), self.processors))
                    charts.append((_chart(self.memory, "GB", None), self.memory))
            for chart, histories in charts:
                fill(chart.options, histories)

        page.every(REFRESH_S / 2, self.name, update)


class ModuleButtons:
    """The buttons with which one page stops and starts modules. Each asks for confirmation.

    Args:
        panel: the panel.
        page: the page of the buttons.
    """

    def __init__(self, panel: SystemPanel, page: Page):
        self._panel = panel
        self._page = page
        self._module = ""
        self._action = ""
        self._given: list[ModuleOrder] = []
        with ui.row().classes("items-center"):
            self._chosen = ui.label()
            self._buttons = [
                ui.button(f"{action} …", on_click=lambda action=action: self._ask(action)).props(
                    f"id=order-{action}"
                )
                for action in ("restart", "stop", "start")
            ]
        with ui.dialog() as self._dialog, ui.card():
            self._question = ui.label()
            with ui.row():
                ui.button("Yes", on_click=self._give, color="deep-orange-10").props("id=confirm-order")
                ui.button("No", on_click=self._dialog.close)
        self.choose([])

    def choose(self, rows: Iterable[Row]) -> None:
        """Select the module of a row, or none."""
        self._module = next((str(row["module"]) for row in rows), "")
        self._chosen.set_text(self._module or "choose a row to restart, stop or start its module")
        for button in self._buttons:
            button.set_visibility(bool(self._module))

    def _ask(self, action: str) -> None:
        self._action = action
        self._question.set_text(f"Really {action} {self._module}? The robot may move.")
        self._dialog.open()

    def _give(self) -> None:
        self._dialog.close()
        if self._page.may("the order"):
            self._given.append(ModuleOrder(self._panel.run_folder, self._action, self._module))

    def update(self) -> None:
        """Show the results of the commands."""
        for order in [order for order in self._given if order.answer is not None]:
            self._given.remove(order)
            ui.notify(order.answer, type="negative" if order.is_refused else "positive", timeout=8000)


def _column(heading: str, *, is_text: bool) -> dict[str, Any]:
    """Describe a column. It is sorted by the values, not by their texts."""
    key = json.dumps(heading)
    return {
        "name": heading,
        "label": heading,
        "field": heading,
        "sortable": True,
        "align": "left" if is_text else "right",
        ":sort": f"(a, b, x, y) => {{ const [p, q] = [x.order[{key}], y.order[{key}]]; "
        "return p < q ? -1 : p > q ? 1 : 0; }",
    }


def _chart(histories: dict[str, ChartHistory], unit: str, largest: float | None) -> ui.echart:
    chart = ui.echart(chart_options(histories, unit, largest), renderer="svg")
    return chart.classes("h-64 w-1/2")
