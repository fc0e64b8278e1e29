"""What every process does, costs and lacks: the columns of `robbie top`."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.cli.top_tables import MODULE_COLUMNS, module_rows
from robbie_mp.observe import RunObserver, RunReading, rates_between
from robbie_mp.services.operator_station.panel import Page, Panel

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.station import OperatorStation

REFRESH_S = 1.0
DESCRIBED_READINGS = 10
"""Quantiles are of the time since so many readings ago."""


class SystemPanel(Panel):
    """The table of processes."""

    name = "system"
    title = "System"
    icon = "memory"

    def __init__(self, station: OperatorStation):
        super().__init__(station)
        self._observer = RunObserver(station.run_id)
        self._readings: deque[RunReading] = deque(maxlen=DESCRIBED_READINGS)
        self._rows: list[dict[str, str]] = []

    def tick(self) -> None:
        """Read the figures, once a second for all pages, if any is open."""
        readings, now_ns = self._readings, time.monotonic_ns()
        if (readings and now_ns - readings[-1].at_ns < REFRESH_S * 1e9) or not self.station.pages:
            return
        readings.append(self._observer.read())
        rates = None
        if len(readings) > 1:
            rates = rates_between(readings[-2], readings[-1], long_before=readings[0])
        self._rows = [
            {column.heading: column.cell(row).plain for column in MODULE_COLUMNS}
            for row in module_rows(readings[-1], rates)
        ]

    def close(self) -> None:
        """Unmap the run."""
        self._observer.close()

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
