"""What the robot is about: its mission, the state machines of all modules, and the victims."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.station.mission_control import MissionControl
from robbie_mp.station.panel import Page, Panel
from robbie_mp.station.run_watch import REFRESH_S
from robbie_mp.station.table_columns import columns
from robbie_mp.station.victim_watch import STATES, KnownVictim

if TYPE_CHECKING:
    from robbie_mp.station.station import OperatorStation


class MissionPanel(Panel):
    """The mission, states and victims."""

    name = "mission"
    title = "Mission"
    icon = "flag"

    def __init__(self, station: OperatorStation):
        super().__init__(station)
        self._control = MissionControl(station)

    def build(self, page: Page) -> None:
        """Make the mission's buttons, and both tables."""
        self._control.build(page, self.name, REFRESH_S / 2)
        states = ui.table(columns=columns("module", "state", "status"), rows=[], row_key="module")
        states.props("dense flat id=mission-states").classes("w-full")
        victims = ui.table(
            columns=columns("number", "name", "state", "x in m", "y in m", "sure", "images"),
            rows=[],
            row_key="number",
            title="Victims",
        )
        victims.props("dense flat id=mission-victims").classes("w-full")

        def update() -> None:
            states.rows = self._state_rows()
            victims.rows = [victim_row(one) for _, one in sorted(self.station.victim_watch.victims.items())]

        page.every(REFRESH_S / 2, self.name, update)

    def _state_rows(self) -> list[dict[str, Any]]:
        reading = self.station.run_watch.reading
        return [
            {"module": module.name, "state": module.states, "status": module.status}
            for module in (reading.modules if reading else ())
            if module.states
        ]


def victim_row(victim: KnownVictim) -> dict[str, Any]:
    """Return what the table shows of a victim."""
    found, position = victim.found, victim.found.pose.position
    return {
        "number": found.id,
        "name": found.name,
        "state": STATES.get(found.state, str(found.state)),
        "x in m": f"{position.x:.2f}",
        "y in m": f"{position.y:.2f}",
        "sure": f"{found.confidence:.0%}",
        "images": found.views,
    }
