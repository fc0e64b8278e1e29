"""The operator's orders to the mission: buttons of those that fit, and why one was refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import MissionOrder, MissionStatus
from robbie_mp.station.access import Role
from robbie_mp.station.sending import header_of_now

if TYPE_CHECKING:
    from robbie_mp.station.panel import Page
    from robbie_mp.station.station import OperatorStation

BUTTONS = (
    ("Start", MissionOrder.START, "play_arrow", "green-9"),
    ("Pause", MissionOrder.PAUSE, "pause", "orange-10"),
    ("Return", MissionOrder.RETURN, "home", "primary"),
    ("Abort …", MissionOrder.ABORT, "stop", "red-10"),
)


class MissionControl:
    """What the mission is about; operators steer it, observers see it."""

    def __init__(self, station: OperatorStation):
        self._station = station
        self._status = station.newest(MissionStatus)

    def order(self, page: Page, order: int) -> None:
        """Send an order to the mission."""
        page.publish(MissionOrder(header=header_of_now(self._station), order=order), "the order")

    def build(self, page: Page, panel: str, period_s: float) -> None:
        """Make buttons and texts on a panel of a page."""
        with ui.row().classes("items-center"):
            state = ui.badge("").props("id=mission-state").classes("text-lg p-2")
            buttons = self._buttons(page) if page.role is Role.OPERATOR else {}
        text = ui.label("").props("id=mission-text")
        refusal = ui.label("").props("id=mission-refusal role=alert").classes("text-negative")

        def update() -> None:
            status = self._status.message
            state.set_text("no mission is heard of" if status is None else status.state)
            text.set_text("" if status is None else status.text)
            refused = "" if status is None else status.refusal
            refusal.set_text(f"Refused: {refused}" if refused else "")
            fitting = [] if status is None else status.orders.tolist()
            for order, button in buttons.items():
                button.set_enabled(order in fitting)

        update()
        page.every(period_s, panel, update)

    def _buttons(self, page: Page) -> dict[int, ui.button]:
        """Make the buttons, by their orders; an aborted mission is over, so that one asks first."""
        dialog = ui.dialog()

        def press(order: int) -> None:
            if order == MissionOrder.ABORT:
                dialog.open()
            else:
                self.order(page, order)

        def abort() -> None:
            dialog.close()
            self.order(page, MissionOrder.ABORT)

        with dialog, ui.card():
            ui.label("Really abort the mission? The robot stops, and the mission ends there.")
            with ui.row():
                ui.button("Abort", on_click=abort, color="red-10").props("id=confirm-abort")
                ui.button("No", on_click=dialog.close)
        made = {}
        for text, order, icon, colour in BUTTONS:
            button = ui.button(text, icon=icon, color=colour, on_click=lambda order=order: press(order))
            made[order] = button.props(f"id=mission-{text.split()[0].lower()}")
        return made
