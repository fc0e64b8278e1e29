"""What every process does, costs and lacks: the columns of `robbie top`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.cli.top_tables import MODULE_COLUMNS, module_rows
from robbie_mp.services.operator_station.panel import Page, Panel
from robbie_mp.services.operator_station.run_watch import REFRESH_S

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.station import OperatorStation


class SystemPanel(Panel):
    """The table of processes."""

    name = "system"
    title = "System"
    icon = "memory"

    def __init__(self, station: OperatorStation):
        super().__init__(station)
        self._rows: list[dict[str, str]] = []
        self._described = 0

    def tick(self) -> None:
        """Describe the newest figures."""
        watch = self.station.run_watch
        if watch.reading is None or watch.count == self._described:
            return
        self._described = watch.count
        self._rows = [
            {column.heading: column.cell(row).plain for column in MODULE_COLUMNS}
            for row in module_rows(watch.reading, watch.rates)
        ]

    def build(self, page: Page) -> None:
        """Make the table."""
        columns = [
            {
                "name": column.heading,
                "label": column.heading,
                "field": column.heading,
                "sortable": True,
                "align": "left" if column.is_text else "right",
            }
            for column in MODULE_COLUMNS
        ]
        table = ui.table(columns=columns, rows=[], row_key="module").props("dense flat").classes("w-full")

        def update() -> None:
            table.rows = self._rows
            table.update()

        page.every(REFRESH_S / 2, self.name, update)
