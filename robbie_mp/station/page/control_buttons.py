"""Who controls the robot, in the strip of all pages, and the buttons that let it go on or hold."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import ControlState, OperatorRequest, SetControl
from robbie_mp.station.page.state_item import GOOD, WARNING, StateItem
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.messages import uint8
    from robbie_mp.station.driving.command import RobotCommand
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

TOPIC = "control"
PERIOD_S = 0.25
BY_HAND = "by hand on the operator's page"
MODES = {ControlState.AUTO: "AUTO", ControlState.MANUAL: "MANUAL", ControlState.HOLD: "HOLD"}
WISHES = {ControlState.AUTO: OperatorRequest.GO_ON, ControlState.HOLD: OperatorRequest.HOLD}
ICONS = {"AUTO": "smart_toy", "MANUAL": "sports_esports", "HOLD": "pause_circle"}


class ControlButtons:
    """Shows who controls the robot, if its base says so, and orders it to go on or to hold.

    Args:
        messages: source of the base's state.
        command: which operator has control of the robot.
    """

    def __init__(self, messages: MessageSource, command: RobotCommand):
        self._command = command
        self._state = messages.newest(ControlState, TOPIC)

    @property
    def item(self) -> StateItem | None:
        """The item of the strip; None while no base says who controls the robot."""
        state = self._state.message
        if state is None:
            return None
        mode = MODES.get(state.mode, f"mode {state.mode}")
        text = mode if mode == "AUTO" else f"{mode}: {state.reason}"
        look = WARNING if mode == "HOLD" else GOOD
        detail = f"{mode}: {state.reason}{f', by {state.who}' if state.who else ''}"
        return StateItem("control", ICONS.get(mode, "help"), text[:32], look, detail)

    def order(self, page: Page, mode: uint8) -> None:
        """Order the robot to go on, or to hold."""
        what = f"the order {MODES[mode]}"
        moves = mode == ControlState.AUTO
        if not self._command.is_elsewhere:
            page.ask(SetControl(mode=mode, reason=BY_HAND), what, success=MODES[mode], moves=moves)
        elif page.may_move(what) if moves else page.may(what):
            self._command.ask(WISHES[mode])

    def build(self, page: Page) -> None:
        """Build the buttons of an operator's page. One that would change nothing is hidden."""
        if page.role is not Role.OPERATOR:
            return
        buttons = {
            ControlState.AUTO: _button("Go on", "play_arrow", "go-on"),
            ControlState.HOLD: _button("Hold", "pause", "hold"),
        }
        for mode, button in buttons.items():
            button.on_click(partial(self.order, page, mode))

        def update() -> None:
            state = self._state.message
            for mode, button in buttons.items():
                button.set_visibility(state is not None and state.mode != mode)

        update()
        page.always(PERIOD_S, update)

    def add_keys(self, page: Page) -> None:
        """Add the keys of an operator's page, after its panels, which may have a better use for G."""
        if page.role is Role.OPERATOR:
            page.add_key(
                "g", "Go on: modules drive the robot again", partial(self.order, page, ControlState.AUTO)
            )
            page.add_key("o", "Hold: stand until told to go on", partial(self.order, page, ControlState.HOLD))


def _button(text: str, icon: str, name: str) -> ui.button:
    return ui.button(text, icon=icon).props(f"flat dense no-caps color=white id={name}")
