"""The mission, the state machines of all modules, and the victims."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.station.page.log_events import EventKind
from robbie_mp.station.page.page import Page, ending
from robbie_mp.station.page.requests import Asked
from robbie_mp.station.page.state_item import ALERT, GOOD, WARNING, StateItem, clock_text
from robbie_mp.station.panel import Panel, columns
from robbie_mp.station.watch.latest import silence
from robbie_mp.station.watch.run import REFRESH_S
from robbie_robots.modules.rescue.messages import MissionStatus, OrderMission, VictimFound
from robbie_robots.modules.rescue.station.mission_results import DONE, ENDS, MissionResults
from robbie_robots.modules.rescue.station.victim_list import VictimList
from robbie_robots.modules.rescue.station.victim_question import VictimQuestion
from robbie_robots.modules.rescue.station.victim_watch import VictimWatch, victim_changes
from robbie_robots.modules.rescue.station.wall_layers import add_wall_layers
from robbie_robots.modules.rescue.station.way_home import WayHome

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.watch.latest import MessageSource

BUTTONS = (
    ("Start", OrderMission.START, "play_arrow", "green-9", "g"),
    ("Pause", OrderMission.PAUSE, "pause", "deep-orange-10", "p"),
    ("Return", OrderMission.RETURN, "home", "primary", "h"),
    ("Abort …", OrderMission.ABORT, "stop", "red-10", "x"),
)
"""Each with its icon, colour and key."""
STYLE = Path(__file__).parent / "mission_panel.css"
SILENT_AFTER_S = 5.0
"""Maximum time between two messages of a mission that works."""
PAUSE = "PAUSE"
MAX_ITEM_CHARACTERS = 28


class MissionPanel(Panel):
    """Shows the mission, state machines and victims; in every layout, the question about a victim."""

    name = "mission"
    title = "Mission"
    icon = "flag"
    log_events = (EventKind("victim", VictimFound, victim_changes, "hail", "light-green-3"),)

    def __init__(self, station: StationContext):
        super().__init__(station)
        messages, marks = station.messages, station.map.marks
        self._figures = station.run.figures
        self._results = MissionResults(messages, station.run.output_directory)
        self._control = MissionControl(messages)
        self._watch = VictimWatch(messages)
        self._question = VictimQuestion(self._watch)
        marks.add("victims", self._watch.marks)
        add_wall_layers(messages, marks)
        marks.area_warnings.append(WayHome(station).warning)

    def build_on_every_tab(self, page: Page) -> None:
        """Build the results of the mission."""
        self._results.build(page)

    def build_below_tiles(self, page: Page) -> None:
        """Build the question about a victim, which covers no tile."""
        self._question.build(page)

    def state_items(self) -> Iterator[StateItem]:
        """Return the mission's state and time for the strip."""
        status = self._control.status
        if status.message is not None:
            yield mission_item(status.message, silence(status.age_s, SILENT_AFTER_S))

    def build(self, page: Page) -> None:
        """Build the mission's buttons, the table of states, and the list of victims."""
        self._control.build(page, self.name, REFRESH_S / 2)
        states = ui.table(columns=columns("module", "state", "status"), rows=[], row_key="module")
        states.props("dense flat id=mission-states").classes("w-full")
        victims = VictimList(page, self._watch)

        def update() -> None:
            states.rows = self._state_rows()
            victims.update()

        page.every(REFRESH_S / 2, self.name, update)

    def _state_rows(self) -> list[dict[str, Any]]:
        reading = self._figures.reading
        return [
            {"module": module.name, "state": module.states, "status": module.status}
            for module in (reading.modules if reading else ())
            if module.states
        ]


class MissionControl:
    """Shows the mission's state. Operators have buttons for the orders that it accepts now."""

    def __init__(self, messages: MessageSource):
        self.status = messages.newest(MissionStatus)

    def build(self, page: Page, panel: str, period_s: float) -> None:
        """Add buttons and texts to a panel of a page."""
        ui.add_css(STYLE)
        state = ui.label("").props("id=mission-state")
        given: deque[Asked] = deque(maxlen=1)
        with ui.element("div").classes("mission-buttons"):
            buttons = self._buttons(page, given) if page.can_command else {}
        text = ui.label("").props("id=mission-text")
        refusal = ui.label("").props("id=mission-refusal role=alert").classes("text-negative")

        def update() -> None:
            status = self.status.message
            state.set_text("no mission has reported" if status is None else status.state)
            text.set_text("" if status is None else status.text)
            refusal.set_text(ending(given[-1]) if given and given[-1].error else "")
            fitting = [] if status is None else status.orders.tolist()
            for order, button in buttons.items():
                button.set_enabled(order in fitting)

        update()
        page.every(period_s, panel, update)

    def _buttons(self, page: Page, given: deque[Asked]) -> dict[int, ui.button]:
        """Build the buttons by order. ABORT asks first, because an aborted mission cannot continue."""
        dialog = ui.dialog()

        def give(order: int) -> None:
            moves = order in (OrderMission.START, OrderMission.RETURN)
            if (asked := page.ask(OrderMission(order=order), "the order", moves=moves)) is not None:
                given.append(asked)

        def press(order: int) -> None:
            if order == OrderMission.ABORT:
                dialog.open()
            else:
                give(order)

        def abort() -> None:
            dialog.close()
            give(OrderMission.ABORT)

        with dialog, ui.card():
            ui.label(
                "Really abort the mission? The robot stops where it is, and the mission cannot continue."
            )
            with ui.row():
                ui.button("Abort", on_click=abort, color="red-10").props("id=confirm-abort")
                ui.button("No", on_click=dialog.close)
        made: dict[int, ui.button] = {}

        def press_key(order: int, text: str) -> None:
            if made[order].enabled:
                press(order)
            else:
                ui.notify(f"{text} does not fit the state of the mission", type="warning")

        for text, order, icon, colour, key in BUTTONS:
            button = ui.button(text, icon=icon, color=colour, on_click=lambda order=order: press(order))
            made[order] = button.props(f"id=mission-{text.split()[0].lower()}")
            button.props["title"] = f"{text} (key {key.upper()})"
            page.add_key(key, f"Mission: {text}", partial(press_key, order, text.removesuffix(" …")))
        return made


def mission_item(status: MissionStatus, silent: str) -> StateItem:
    """Return the mission's state and time as the strip shows them.

    Args:
        status: the mission's newest status.
        silent: how long the mission has been silent; '' if it is not.
    """
    limit = f" / {clock_text(status.limit_s)}" if math.isfinite(status.limit_s) else ""
    used = f" {clock_text(status.used_s)}{limit}" if math.isfinite(status.used_s) else ""
    text, detail = f"{status.state}{used}"[:MAX_ITEM_CHARACTERS], status.text
    if status.state in ENDS:
        look = GOOD if status.state == DONE else WARNING
        return StateItem("mission", "flag", text, look, detail)
    if silent:
        return StateItem("mission", "flag", text, ALERT, f"the mission has been silent for {silent}")
    if status.state == PAUSE:
        return StateItem("mission", "pause", text, WARNING, f"the robot is paused; {detail}")
    return StateItem("mission", "flag", text, GOOD, detail)
