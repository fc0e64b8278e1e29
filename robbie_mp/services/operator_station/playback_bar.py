"""What plays, if a log does: a bar that says so on every tab, and steers it."""

from __future__ import annotations

import math
import secrets
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.events import GenericEventArguments

from robbie_mp.cli.playback import describe
from robbie_mp.messages import PlaybackControl, PlaybackState
from robbie_mp.services.operator_station.access import Role

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.panel import Page
    from robbie_mp.services.operator_station.station import OperatorStation

RATES = {0.25: "¼", 0.5: "½", 1.0: "1", 2.0: "2", 4.0: "4", 10.0: "10", math.inf: "max"}
"""Times real time."""


class PlaybackBar:
    """Not to be seen unless there is a playback in the run."""

    def __init__(self, station: OperatorStation):
        self._station = station
        self._state = station.newest(PlaybackState)

    def order(self, command: str, value: float = 0.0) -> None:
        """Steer the playback."""
        control = PlaybackControl(request=secrets.randbits(63), command=command, value=value)
        if not self._station.publish(control):
            ui.notify(f"{command} was not sent: the robot's memory is full", type="negative")

    def _on_seek(self, event: GenericEventArguments) -> None:
        if isinstance(event.args, int | float) and math.isfinite(event.args):
            self.order("seek", float(event.args))

    def build(self, page: Page) -> None:
        """Make the bar for a page; observers see where it stands."""
        with ui.card().classes("w-full bg-purple-10 no-shadow").props("id=playback") as bar:
            text = ui.label("").props("id=playback-text role=status")
            with ui.row().classes("w-full items-center no-wrap"):
                if page.role is Role.OPERATOR:
                    pause = ui.button(icon="pause", on_click=lambda: self.order("pause"))
                    pause.props('id=playback-pause aria-label="Pause"')
                    play = ui.button(icon="play_arrow", on_click=lambda: self.order("resume"))
                    play.props('id=playback-resume aria-label="Resume"')
                    step = ui.button(icon="skip_next", on_click=lambda: self.order("step"))
                    step.props('id=playback-step aria-label="Step" title="One message"')
                    rate = ui.select(RATES, label="rate").classes("w-20").props("id=playback-rate")
                    rate.on("update:model-value", lambda: self.order("rate", float(rate.value)))
                place = ui.slider(min=0.0, max=1.0, step=0.001).props('aria-label="Position in s"')
                place.set_enabled(page.role is Role.OPERATOR)
                if page.role is Role.OPERATOR:
                    place.on("change", self._on_seek)  # which a hand causes, and no new position
                held: list[bool] = []
                place.on("pan", lambda event: held.append(True) if event.args == "start" else held.clear())
        bar.set_visibility(False)
        shown = [0]

        def update() -> None:
            state = self._state.message
            if state is None or shown[0] == self._state.count:
                return
            shown[0] = self._state.count
            bar.set_visibility(True)
            error = f"; refused: {state.error}" if state.error else ""
            text.set_text(f"PLAYBACK of {state.file}: {describe(state)}{error}")
            place.props(f"max={max(0.001, seconds(state, state.end.nanoseconds)):.3f}")
            if not held:
                place.set_value(seconds(state, state.position.nanoseconds))
            if page.role is Role.OPERATOR:
                pause.set_visibility(not state.paused)
                play.set_visibility(state.paused)
                rate.set_value(state.rate if state.rate in RATES else None)

        page.always(0.1, update)


def seconds(state: PlaybackState, time_ns: int) -> float:
    """Return how long after the log's begin a time of the log is."""
    return round((time_ns - state.begin.nanoseconds) / 1e9, 3)
