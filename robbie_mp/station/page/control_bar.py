"""The control bar above the tiles of every layout: who controls the robot, why, and the page's delay."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element

from robbie_mp.messages import ControlState, OperatorRequest, SetControl
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.messages import uint8
    from robbie_mp.station.driving.operators import Operators
    from robbie_mp.station.page.page import Drives, Page
    from robbie_mp.station.watch.latest import MessageSource

TOPIC = "control"
PERIOD_S = 0.1
BY_HAND = "by hand on the operator's page"
MODES = {ControlState.AUTO: "AUTO", ControlState.MANUAL: "MANUAL", ControlState.HOLD: "HOLD"}
WISHES = {ControlState.AUTO: OperatorRequest.GO_ON, ControlState.HOLD: OperatorRequest.HOLD}
STYLE = Path(__file__).parent / "control_bar.css"


class Bar(Element, component="control_bar.js"):
    """Shows the state and has the buttons. The script knows the age of the page's own link."""

    def show(self, now: dict[str, Any]) -> None:
        """Show a state, if it has changed."""
        if self._props.get("now") != now:
            self._props["now"] = now
            self.update()


class ControlBar:
    """Shows who controls the robot, and orders it to go on or to hold.

    Args:
        messages: source of the base's state.
        operators: the open pages, and who drives.
    """

    def __init__(self, messages: MessageSource, operators: Operators):
        self._operators = operators
        self._state = messages.newest(ControlState, TOPIC)

    def order(self, page: Page, mode: uint8) -> None:
        """Order the robot to go on, or to hold."""
        what = f"the order {MODES[mode]}"
        moves = mode == ControlState.AUTO
        command = self._operators.command
        if not command.is_elsewhere:
            page.ask(SetControl(mode=mode, reason=BY_HAND), what, success=MODES[mode], moves=moves)
        elif page.may_move(what) if moves else page.may(what):
            command.ask(WISHES[mode])

    def build(self, page: Page) -> None:
        """Build the bar of a page. An observer's has no buttons."""
        ui.add_css(STYLE)
        bar = Bar().props("id=control-bar")
        bar.on("order", partial(self._on_order, page))
        bar.show(self.shown(page))
        page.always(PERIOD_S, lambda: bar.show(self.shown(page)))

    def _on_order(self, page: Page, event: GenericEventArguments) -> None:
        if event.args == "take over" and page.driver is not None:
            page.driver.take_over()
        for mode in WISHES:
            if event.args == MODES[mode]:
                self.order(page, mode)

    def add_keys(self, page: Page) -> None:
        """Add the keys of an operator's page, after its panels, which may have a better use for G."""
        if page.role is Role.OPERATOR:
            page.add_key(
                "g", "Go on: modules drive the robot again", partial(self.order, page, ControlState.AUTO)
            )
            page.add_key("o", "Hold: stand until told to go on", partial(self.order, page, ControlState.HOLD))

    def shown(self, page: Page) -> dict[str, Any]:
        """Return what the bar of a page shows now."""
        state, driver = self._state.message, page.driver
        mode = "" if state is None else MODES.get(state.mode, f"mode {state.mode}")
        orders = [] if state is None else [MODES[one] for one in WISHES if one != state.mode]
        if driver is not None and driver.is_other_driving:
            orders.append("take over")
        alert = driver.delay if driver is not None else ""
        return {
            "mode": mode,
            "who": self._who(page),
            "why": alert or self._why(driver),
            "alert": bool(alert),
            "orders": orders,
            "is_operator": page.role is Role.OPERATOR,
        }

    def _who(self, page: Page) -> str:
        """Return who moves the robot now, and who else has control."""
        holder, state = self._operators.seat.holder, self._state.message
        if self._operators.command.other:
            return self._operators.command.text
        by_page = "" if holder is None else "you" if holder == page.key else "another page"
        if state is None:
            return f"{by_page or 'nobody'} drive{'' if by_page == 'you' else 's'}"
        if state.mode == ControlState.MANUAL:
            return "you drive" if by_page == "you" else f"{by_page or state.who} drives"
        text = "modules drive" if state.mode == ControlState.AUTO else "nobody drives"
        return f"{text}; another page has control" if by_page == "another page" else text

    def _why(self, driver: Drives | None) -> str:
        """Return why the robot is controlled in this way, and whose commands do not count."""
        state, rival = self._state.message, self._operators.command.rival
        parts = [
            "" if state is None else state.reason,
            f"commands of {rival} are refused" if rival else "",
            f"{driver.refused} commands of this page were refused" if driver and driver.refused else "",
            f"{driver.stale} commands came too late" if driver and driver.stale else "",
        ]
        return "; ".join(filter(None, parts))
