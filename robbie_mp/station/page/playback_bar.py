"""A bar on every tab that shows and controls the playback of a log."""

from __future__ import annotations

import math
import secrets
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.attached.views.message_text import describe_playback
from robbie_mp.messages import PlaybackControl, PlaybackState
from robbie_mp.station.page.log_events import EventKind, LogEvent, LogEvents
from robbie_mp.station.page.slider import Slider
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

RATES = {0.25: "¼", 0.5: "½", 1.0: "1", 2.0: "2", 4.0: "4", 10.0: "10", math.inf: "max"}
"""Rates, as multiples of real time."""


class PlaybackBar:
    """Hidden unless there is a playback in the run.

    Args:
        messages: source of the playback's state.
        kinds: the events to show, besides crashes and marks.
    """

    def __init__(self, messages: MessageSource, kinds: Iterable[EventKind] = ()):
        self._state = messages.newest(PlaybackState)
        self.events = LogEvents(kinds)

    @property
    def has_log(self) -> bool:
        """Whether a log plays, or is paused."""
        return self._state.message is not None

    def order(self, page: Page, command: str, value: float = 0.0) -> None:
        """Control the playback."""
        control = PlaybackControl(request=secrets.randbits(63), command=command, value=value)
        page.publish(control, f"{command} of the playback")

    def _turn(self, page: Page) -> None:
        state = self._state.message
        if state is not None:
            self.order(page, "resume" if state.paused else "pause")

    def _seek(self, page: Page, position_s: object) -> None:
        if isinstance(position_s, int | float) and math.isfinite(position_s):
            self.order(page, "seek", float(position_s))

    def build(self, page: Page) -> None:
        """Build the bar for a page. Observers only see the position."""
        with (
            ui.card().classes("w-full playback-bar no-shadow").props("id=playback") as bar,
            ui.row().classes("w-full items-center no-wrap"),
        ):
            if page.role is Role.OPERATOR:
                page.add_key("k", "Playback: pause or resume", lambda: self._turn(page))
                page.add_key(".", "Playback: one step", lambda: self.order(page, "step"))
                pause = ui.button(icon="pause", on_click=lambda: self.order(page, "pause"))
                pause.props('id=playback-pause aria-label="Pause"')
                play = ui.button(icon="play_arrow", on_click=lambda: self.order(page, "resume"))
                play.props('id=playback-resume aria-label="Resume"')
                step = ui.button(icon="skip_next", on_click=lambda: self.order(page, "step"))
                step.props('id=playback-step aria-label="Step" title="One message"')
                rate = ui.select(RATES, label="rate").classes("w-20").props("id=playback-rate dense")
                rate.on_value_change(lambda event: choose_rate(event.value))
            with ui.column().classes("w-full gap-0"):
                text = ui.label("").props("id=playback-text role=status")
                marks = EventMarks(self, page)
                place = Slider(min=0.0, max=1.0, step=0.001).props('aria-label="Position in s"')
            place.set_enabled(page.role is Role.OPERATOR)
            if page.role is Role.OPERATOR:
                # Only the operator causes these two; a new position does not. The position may change
                # between them, and then the slider's own value is not what the operator has chosen.
                chosen: deque[object] = deque(maxlen=1)
                place.on("update:model-value", lambda event: chosen.append(event.args))
                place.on("change", lambda event: self._seek(page, chosen.pop() if chosen else event.args))
            held: list[bool] = []
            place.on("pan", lambda event: held.append(True) if event.args == "start" else held.clear())
        bar.set_visibility(False)
        shown = [0]
        shown_rate: list[float | None] = [None]

        def choose_rate(chosen: float | None) -> None:
            if chosen is not None and chosen != shown_rate[0]:  # by hand
                self.order(page, "rate", chosen)

        def update() -> None:
            state = self._state.message
            if state is None or shown[0] == self._state.count:
                return
            shown[0] = self._state.count
            bar.set_visibility(True)
            error = f"; refused: {state.error}" if state.error else ""
            text.set_text(f"PLAYBACK of {state.file}: {describe_playback(state)}{error}")
            place.props(f"max={max(0.001, seconds(state, state.end.nanoseconds)):.3f}")
            marks.update(state)
            if not held:
                place.set_value(seconds(state, state.position.nanoseconds))
            if page.role is Role.OPERATOR:
                pause.set_visibility(not state.paused)
                play.set_visibility(state.paused)
                shown_rate[0] = state.rate if state.rate in RATES else None
                rate.set_value(shown_rate[0])

        page.always(0.1, update)


class EventMarks:
    """The events of the log, each at its place above the bar. A press on one plays from there.

    Args:
        bar: holds the events, and controls the playback.
        page: the page. Observers cannot press events.
    """

    def __init__(self, bar: PlaybackBar, page: Page):
        self._bar = bar
        self._page = page
        self._shown: object = None
        self._area = ui.element("div").classes("relative w-full h-8").props("id=playback-events")

    def update(self, state: PlaybackState) -> None:
        """Show the events of the log that plays, if they have changed."""
        events = self._bar.events
        events.read(state.file)
        now = (events.found, events.error, state.begin, state.end)
        if now == self._shown:
            return
        self._shown = now
        self._area.clear()
        length_s = max(0.001, seconds(state, state.end.nanoseconds))
        with self._area:
            for event in events.found:
                if 0 <= (at_s := seconds(state, event.time_ns)) <= length_s:
                    self._add(event, at_s, at_s / length_s)
            if events.error:
                ui.label(f"its events cannot be shown: {events.error}").classes("text-xs")

    def _add(self, event: LogEvent, at_s: float, share: float) -> None:
        button = ui.button(icon=event.kind.icon, color=event.kind.colour)
        button.on_click(lambda: self._bar.order(self._page, "seek", at_s))
        button.props(f"flat dense round size=sm data-at={at_s:.3f}")
        button.set_enabled(self._page.role is Role.OPERATOR)
        button.props["aria-label"] = button.props["title"] = f"{event.text}, at {at_s:.1f} s"
        button.style(f"position: absolute; left: calc({100 * share:.2f}% - 1rem)")


def seconds(state: PlaybackState, time_ns: int) -> float:
    """Return the time since the log's beginning, s."""
    return round((time_ns - state.begin.nanoseconds) / 1e9, 3)
