"""The emergency stop: always visible, latched by the base, released only by a confirmed press."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

from robbie_mp.messages import EmergencyStop
from robbie_mp.station.context import header_of_now
from robbie_mp.station.stop.connection import StopService
from robbie_mp.station.stop.requests import REQUEST_TOPIC, STATE_TOPIC, StopRequests, state_text
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.module.clock import Clock
    from robbie_mp.station.module import Publish
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

STOPPED_BY = "stopped by hand on the operator's page"
RELEASED_BY = "released by hand on the operator's page"
RELEASE_PERIOD_S = 0.25
"""Time between two looks whether the button that releases the stop is shown."""
STYLE = Path(__file__).parent / "emergency_stop.css"


class StopButton(Element, component="emergency_stop.js"):
    """The button and the base's state. Its script keeps a press until the base has confirmed it."""


class EmergencyStopControl:
    """The emergency stop on all pages. Every visitor may stop the robot; only operators may release it.

    Args:
        messages: source of the base's state.
        clock: tells the time.
        publish: sends stops and releases to the base.
        can_release: whether pages have the button that releases it.
        log_source: name of the module that plays a log; '' if there is none.

    Attributes:
        service: serves the buttons of all pages.
        requests: the presses that the base has not confirmed.
    """

    def __init__(
        self,
        messages: MessageSource,
        clock: Clock,
        publish: Publish,
        *,
        can_release: bool = True,
        log_source: str = "",
    ):
        self._can_release = can_release
        self._log_source = log_source
        self._is_of_log = bool(log_source)
        self._messages = messages
        self._clock = clock
        self._publish = publish
        self._state = messages.newest(EmergencyStop, STATE_TOPIC)
        self.requests = StopRequests(self._send)
        self._heard_s: float | None = None
        self._state.listen(self._see)
        self.service = StopService(self.requests, self._state, self._age_s, lambda: self._is_of_log)

    def tick(self) -> None:
        """Repeat presses that the base has not confirmed; called in the module's thread."""
        self.requests.repeat()

    def _send(self, engaged: bool) -> bool:
        """Request the base to stop and stay stopped, or to be ready to drive again."""
        reason = STOPPED_BY if engaged else RELEASED_BY
        message = EmergencyStop(header=header_of_now(self._clock), engaged=engaged, reason=reason)
        return self._publish(message, topic=REQUEST_TOPIC)

    @property
    def state_text(self) -> str:
        """The state of this robot's stop, in the words of the other robots of its team."""
        state = None if self._is_of_log else self._state.message
        return state_text(self.requests.waits_s, None if state is None else state.engaged, self._age_s())

    def _age_s(self) -> float | None:
        """Return how long ago a base has reported, by this machine's clock: a log beside it may be paused."""
        return None if self._heard_s is None else time.monotonic() - self._heard_s

    def _see(self, state: EmergencyStop) -> None:
        self._heard_s = time.monotonic()
        self._is_of_log = self._log_source == self._messages.envelope.sender
        if self._is_of_log:
            return  # what a base once said confirms no press
        self.requests.see(engaged=state.engaged, published_s=self._messages.envelope.published_ns / 1e9)

    @property
    def _can_be_released(self) -> bool:
        is_engaged = self._state.message is not None and self._state.message.engaged
        return not self._is_of_log and (is_engaged or self.requests.waits_s is not None)

    def build(self, page: Page) -> None:
        """Build the stop button of a page, and the button that releases the stop."""
        ui.add_css(STYLE)
        StopButton()
        if self._can_release:
            self._build_release(page)

    def _build_release(self, page: Page) -> None:
        def release() -> None:
            dialog.close()
            if page.may_move("the release of the emergency stop") and not self.requests.release():
                ui.notify("the release was not sent: the robot's memory is full", type="negative")

        with ui.dialog() as dialog, ui.card():
            ui.label("Release the emergency stop? The robot holds until you drive, or press Go on.")
            with ui.row():
                ui.button("Release", on_click=release, color="deep-orange-10").props("id=confirm-release")
                ui.button("Keep it stopped", on_click=dialog.close)
        # It keeps its place while it is invisible, so that nothing else moves.
        again = ui.button("Release …", on_click=dialog.open).props("id=release-emergency-stop no-caps")

        def ask() -> None:
            if self._can_be_released and page.role is Role.OPERATOR:
                dialog.open()

        if page.role is Role.OPERATOR:
            page.add_key("r", "Release the emergency stop, after a confirmation", ask)

        def update() -> None:
            is_shown = self._can_be_released and page.role is Role.OPERATOR
            again.classes(remove="invisible" if is_shown else "", add="" if is_shown else "invisible")

        update()
        page.always(RELEASE_PERIOD_S, update)
