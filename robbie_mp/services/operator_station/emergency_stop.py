"""The emergency stop: always in sight, on a key, latched by the base and released on purpose only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.events import KeyEventArguments

from robbie_mp.messages import EmergencyStop
from robbie_mp.services.operator_station.access import Role
from robbie_mp.services.operator_station.panel import Page
from robbie_mp.services.operator_station.sending import header_of_now

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.station import OperatorStation

REQUEST_TOPIC = "emergency_stop"
STATE_TOPIC = "emergency_stop_state"
KEY = "Escape"


class EmergencyStopBar:
    """The button at the top of every page, and what the base has answered."""

    def __init__(self, station: OperatorStation):
        self._station = station
        self._state = station.newest(EmergencyStop, STATE_TOPIC)

    @property
    def is_engaged(self) -> bool:
        """Whether the base has said that it stands and stays."""
        return self._state.message is not None and self._state.message.engaged

    def request(self, page: Page, *, engaged: bool, reason: str) -> None:
        """Ask the base to stop and stay, or, for an operator, to be ready to drive again."""
        header = header_of_now(self._station)
        message = EmergencyStop(header=header, engaged=engaged, reason=reason)
        what, needs = ("the emergency stop", Role.OBSERVER) if engaged else ("its release", Role.OPERATOR)
        page.publish(message, what, REQUEST_TOPIC, needs)

    def build(self, page: Page) -> None:
        """Make button and indicator for a page. Everybody may stop the robot; operators release it."""

        def stop() -> None:
            self.request(page, engaged=True, reason="stopped by hand on the operator's page")

        def release() -> None:
            dialog.close()
            self.request(page, engaged=False, reason="released by hand on the operator's page")

        button = ui.button("EMERGENCY STOP", icon="dangerous", color="red-10")
        button.props('size=lg id=emergency-stop aria-keyshortcuts="Escape"').classes("font-bold")
        # When it is pressed, not when it is let go; clicks without a pointer are those of the keyboard.
        button.on("pointerdown", stop, [])
        button.on("click", stop, js_handler="(event) => { if (event.detail === 0) emit(); }")

        def on_key(event: KeyEventArguments) -> None:
            if event.key == KEY and event.action.keydown:
                stop()

        ui.keyboard(on_key, repeating=False, ignore=[])
        shown = ui.badge("").props("id=emergency-stop-state").classes("text-lg p-2")
        with ui.dialog() as dialog, ui.card():
            ui.label("Release the emergency stop? The robot may move at once.")
            with ui.row():
                ui.button("Release", on_click=release, color="orange-10").props("id=confirm-release")
                ui.button("Keep it stopped", on_click=dialog.close)
        again = ui.button("Release …", on_click=dialog.open).props("id=release-emergency-stop")

        def update() -> None:
            state = self._state.message
            shown.set_text("base silent" if state is None else "STOPPED" if state.engaged else "ready")
            shown.props(f"color={'grey' if state is None else 'red' if state.engaged else 'green-9'}")
            again.set_visibility(self.is_engaged and page.role is Role.OPERATOR)

        page.always(0.1, update)
