"""A bar below the tiles that shows and controls the playback of a log: time line, events, bookmarks."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import ui
from nicegui.element import Element

from robbie_mp.attached.views.message_text import describe_playback
from robbie_mp.messages import PlaybackControl, PlaybackState, Time, replace
from robbie_mp.station.page.log_events import EventKind, LogEvents
from robbie_mp.station.page.menus import popup
from robbie_mp.station.page.slider import Slider
from robbie_mp.station.page.state_item import clock_text
from robbie_mp.station.page.tool_button import tool_button
from robbie_mp.station.past.bookmarks import MAX_BOOKMARKS, MAX_TEXT, Bookmark, Bookmarks
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import MessageSource

RATES = {0.25: "¼", 0.5: "½", 1.0: "1", 2.0: "2", 4.0: "4", 10.0: "10", math.inf: "max"}
"""Rates, as multiples of real time."""
LEAP_S = 5.0
"""How far an arrow key goes back or ahead."""
ANSWERED_WITHIN_S = 2.0
"""If the playback has not answered an order within this time, the order counts as lost."""
SHORTEST_S = 1.0
"""The smallest part of a log to which the time line can be enlarged."""
BOOKMARK = "blue-3"


class LogClock(Element, component="log_clock.js"):
    """Shows the log's time, here and in the head of each tile.

    Args:
        rules: whether the ages on the page are in that time.
    """

    def __init__(self, *, rules: bool):
        super().__init__()
        self._props["rules"] = rules

    def show(self, state: PlaybackState) -> None:
        """Show the time of a log."""
        self._props["now"] = {
            "position_s": state.position.nanoseconds / 1e9,
            "rate": None if math.isinf(state.rate) else state.rate,
            "is_standing": state.paused or state.ended,
            "doing": "ended" if state.ended else "paused" if state.paused else "plays",
        }
        self.update()


class PlaybackBar:
    """Hidden unless there is a playback in the run.

    Args:
        messages: source of the playback's state.
        kinds: the events to show, besides crashes and marks.
    """

    def __init__(self, messages: MessageSource, kinds: Iterable[EventKind] = ()):
        self._state = messages.newest(PlaybackState)
        self._coming: tuple[float, PlaybackState] | None = None
        """When the last order was given, and the state that it leads to."""
        self.events = LogEvents(kinds)
        self.bookmarks = Bookmarks()

    @property
    def has_log(self) -> bool:
        """Whether a log plays, or is paused."""
        return self._state.message is not None

    def order(self, page: Page, command: str, value: float = 0.0) -> None:
        """Control the playback."""
        before = self._expected()
        control = PlaybackControl(request=secrets.randbits(63), command=command, value=value)
        if page.publish(control, f"{command} of the playback") and before is not None:
            self._coming = time.monotonic(), changed(before, control)

    def _expected(self) -> PlaybackState | None:
        """Return the state to which the last order leads: keys may be quicker than its answer."""
        state = self._state.message
        if state is not None and self._coming is not None:
            ordered_s, coming = self._coming
            if coming.request != state.request and time.monotonic() - ordered_s < ANSWERED_WITHIN_S:
                return coming
        self._coming = None
        return state

    def _turn(self, page: Page) -> None:
        if (state := self._expected()) is not None:
            self.order(page, "resume" if state.paused else "pause")

    def _seek(self, page: Page, position_s: float) -> None:
        self.order(page, "seek", position_s)

    def _leap(self, page: Page, by_s: float) -> None:
        """Go back or ahead from where the log is."""
        if (state := self._expected()) is not None:
            at_s = seconds(state, state.position.nanoseconds) + by_s
            self._seek(page, min(max(0.0, at_s), seconds(state, state.end.nanoseconds)))

    def _change_rate(self, page: Page, *, up: bool) -> None:
        """Play at the next higher or lower rate."""
        if (state := self._expected()) is None:
            return
        others = [rate for rate in RATES if (rate > state.rate if up else rate < state.rate)]
        if others:
            self.order(page, "rate", others[0] if up else others[-1])

    def _bookmark(self, page: Page) -> None:
        """Mark the moment of the log that is shown."""
        state = self._state.message
        if state is None or not page.may("a bookmark"):
            return
        new = self.bookmarks.add(state.position.nanoseconds)
        if new is None:
            ui.notify(f"there are {MAX_BOOKMARKS} bookmarks already", type="negative")
        else:
            ui.notify(f"{new.text}: {clock_text(seconds(state, new.time_ns))}")

    def add_keys(self, page: Page) -> None:
        """Add the keys of an operator's page; those that steer a live robot keep them."""
        page.add_key("k", "Playback: pause or resume", lambda: self._turn(page))
        page.add_key(".", "Playback: one step", lambda: self.order(page, "step"))
        if not page.plays_log:
            return
        page.add_key(" ", "Playback: pause or resume", lambda: self._turn(page))
        page.add_key("+", "Playback: faster", lambda: self._change_rate(page, up=True))
        page.add_key("-", "Playback: slower", lambda: self._change_rate(page, up=False))
        page.add_key("arrowleft", f"Playback: {LEAP_S:g} s back", lambda: self._leap(page, -LEAP_S))
        page.add_key("arrowright", f"Playback: {LEAP_S:g} s ahead", lambda: self._leap(page, LEAP_S))
        page.add_key("m", "Playback: bookmark this moment", lambda: self._bookmark(page))

    def build(self, page: Page) -> None:
        """Build the bar for a page. Observers only see the position."""
        is_operator = page.role is Role.OPERATOR
        line = TimeLine()
        with (
            ui.card().classes("w-full playback-bar no-shadow").props("id=playback") as bar,
            ui.row().classes("w-full items-center no-wrap"),
        ):
            if is_operator:
                self.add_keys(page)
                update_buttons = self._build_buttons(page)
            with ui.column().classes("playback-line gap-0"):
                with ui.row().classes("w-full items-center playback-head"):
                    clock = LogClock(rules=page.plays_log).props("id=playback-clock")
                    text = ui.label("").props("id=playback-text role=status")
                    ui.space()
                    line.build_tools()
                    if is_operator:
                        self._build_bookmarks(page)
                marks = EventMarks(self, page)
                place, held = self._build_slider(page)
        bar.set_visibility(False)
        shown: list[object] = [None]

        def update() -> None:
            state = self._state.message
            now = (self._state.count, line.wanted, self.bookmarks.all)
            if state is None or shown[0] == now:
                return
            shown[0] = now
            bar.set_visibility(True)
            self.bookmarks.open(state.file)
            window = line.look(state)
            error = f"; refused: {state.error}" if state.error else ""
            text.set_text(f"PLAYBACK of {Path(state.file).name}: {describe_playback(state)}{error}")
            text.props["title"] = state.file
            place.show(*window)
            marks.update(state, window)
            clock.show(state)
            if not held:
                place.set_value(seconds(state, state.position.nanoseconds))
            if is_operator:
                update_buttons(state)

        page.always(0.1, update)

    def _build_slider(self, page: Page) -> tuple[Slider, list[bool]]:
        """Build the slider; return also what is not empty while it is dragged."""
        place = Slider(min=0.0, max=1.0, step=0.001).props('aria-label="Position in s"')
        place.set_enabled(page.role is Role.OPERATOR)
        if page.role is Role.OPERATOR:
            place.on_chosen(lambda position_s: self._seek(page, position_s))
        held: list[bool] = []
        place.on("pan", lambda event: held.append(True) if event.args == "start" else held.clear())
        return place, held

    def _build_buttons(self, page: Page) -> Any:
        """Build what steers the playback; return a function that shows its state."""
        pause = ui.button(icon="pause", on_click=lambda: self.order(page, "pause"))
        pause.props('id=playback-pause aria-label="Pause"')
        play = ui.button(icon="play_arrow", on_click=lambda: self.order(page, "resume"))
        play.props('id=playback-resume aria-label="Resume"')
        step = ui.button(icon="skip_next", on_click=lambda: self.order(page, "step"))
        step.props('id=playback-step aria-label="Step" title="One message"')
        rate = ui.select(RATES, label="rate").classes("w-20").props("id=playback-rate dense")
        shown_rate: list[float | None] = [None]

        def choose_rate(chosen: float | None) -> None:
            if chosen is not None and chosen != shown_rate[0]:  # by hand
                self.order(page, "rate", chosen)

        def show(state: PlaybackState) -> None:
            pause.set_visibility(not state.paused)
            play.set_visibility(state.paused)
            shown_rate[0] = state.rate if state.rate in RATES else None
            rate.set_value(shown_rate[0])

        rate.on_value_change(lambda event: choose_rate(event.value))
        return show

    def _build_bookmarks(self, page: Page) -> None:
        """Build the button that marks the moment, and the list of bookmarks."""
        add = tool_button("bookmark_add", "playback-bookmark", "Bookmark this moment")
        add.on_click(lambda: self._bookmark(page))
        button = tool_button("bookmarks", "playback-bookmarks", "Bookmarks")

        def fill() -> None:
            rows.clear()
            with rows:
                if not self.bookmarks.all:
                    ui.label("No bookmark yet: M, or the button beside, makes one.")
                if self.bookmarks.error:
                    ui.label(self.bookmarks.error).classes("text-negative")
                for one in self.bookmarks.all:
                    self._build_bookmark(page, one, fill)

        with button, popup("Bookmarks"):
            rows = ui.column().classes("q-pa-sm gap-0")
        button.on_click(fill)

    def _build_bookmark(self, page: Page, bookmark: Bookmark, again: Any) -> None:
        state = self._state.message
        at_s = 0.0 if state is None else seconds(state, bookmark.time_ns)

        def rename() -> None:
            if page.may("a name of a bookmark"):
                self.bookmarks.rename(bookmark, str(name.value or ""))
                again()

        def remove() -> None:
            if page.may("the removal of a bookmark"):
                self.bookmarks.remove(bookmark)
                again()

        with ui.row().classes("items-center no-wrap"):
            go = ui.button(clock_text(at_s), on_click=lambda: self._seek(page, at_s)).props(
                "flat dense no-caps"
            )
            go.props["aria-label"] = f"Go to {bookmark.text}"
            name = ui.input(value=bookmark.text).props(
                f'dense borderless maxlength={MAX_TEXT} aria-label="Name"'
            )
            name.on("keyup.enter", rename)
            name.on("blur", rename)
            delete = ui.button(icon="delete", on_click=remove).props("flat dense")
            delete.props["aria-label"] = delete.props["title"] = f"Remove {bookmark.text}"


class Window(NamedTuple):
    """The part of a log that the time line shows, s since its beginning."""

    begin_s: float
    end_s: float


class TimeLine:
    """Which part of the log the time line of one page shows: all of it, or an enlarged part that follows.

    Attributes:
        wanted: length of that part, s; infinite: all.
    """

    def __init__(self) -> None:
        self.wanted = math.inf
        self._length_s = 0.0
        self._begin_s = 0.0
        self._at_s = 0.0

    def build_tools(self) -> None:
        """Build the buttons that enlarge the time line, and what says which part it shows."""
        self._text = ui.label("").props("id=playback-shown")
        tool_button("zoom_in", "playback-zoom-in", "Enlarge the time line").on_click(lambda: self._zoom(0.5))
        tool_button("zoom_out", "playback-zoom-out", "Show more of the log").on_click(lambda: self._zoom(2.0))
        self._all = tool_button("fit_screen", "playback-zoom-all", "Show the whole log")
        self._all.on_click(lambda: self._zoom(math.inf))

    def _zoom(self, factor: float) -> None:
        wanted = max(SHORTEST_S, min(self.wanted, self._length_s) * factor)
        self.wanted = wanted if wanted < self._length_s else math.inf
        if math.isfinite(self.wanted):
            self._begin_s = self._at_s - self.wanted / 2

    def look(self, state: PlaybackState) -> Window:
        """Return the part to show now: it follows when the log leaves it."""
        self._length_s = max(0.001, seconds(state, state.end.nanoseconds))
        self._at_s = at_s = seconds(state, state.position.nanoseconds)
        length_s = min(self.wanted, self._length_s)
        if not self._begin_s <= at_s <= self._begin_s + length_s:
            self._begin_s = at_s - 0.1 * length_s
        self._begin_s = begin_s = max(0.0, min(self._begin_s, self._length_s - length_s))
        is_part = length_s < self._length_s
        end_s = begin_s + length_s
        self._text.set_text(f"{clock_text(begin_s)} to {clock_text(end_s)} of {clock_text(self._length_s)}")
        self._text.set_visibility(is_part)
        self._all.set_enabled(is_part)
        return Window(begin_s, end_s)


class EventMarks:
    """Events and bookmarks of the log, each at its place above the bar. A press on one plays from there.

    Args:
        bar: holds them, and controls the playback.
        page: the page. Observers cannot press events.
    """

    def __init__(self, bar: PlaybackBar, page: Page):
        self._bar = bar
        self._page = page
        self._shown: object = None
        self._area = ui.element("div").classes("relative w-full h-8").props("id=playback-events")

    def update(self, state: PlaybackState, window: Window) -> None:
        """Show the events of the log that plays, if they have changed."""
        events, bookmarks = self._bar.events, self._bar.bookmarks.all
        events.read(state.file)
        now = (events.found, events.error, state.begin, state.end, bookmarks, window)
        if now == self._shown:
            return
        self._shown = now
        self._area.clear()
        marks = [(one.time_ns, one.text, one.kind.icon, one.kind.colour) for one in events.found]
        marks += [(one.time_ns, one.text, "bookmark_added", BOOKMARK) for one in bookmarks]
        with self._area:
            for time_ns, text, icon, colour in marks:
                at_s = seconds(state, time_ns)
                if window.begin_s <= at_s <= window.end_s:
                    share = (at_s - window.begin_s) / (window.end_s - window.begin_s)
                    self._add(text, at_s, share, icon, colour)
            if events.error:
                ui.label(f"its events cannot be shown: {events.error}").classes("text-xs")

    def _add(self, text: str, at_s: float, share: float, icon: str, colour: str) -> None:
        button = ui.button(icon=icon, color=colour)
        button.on_click(lambda: self._bar.order(self._page, "seek", at_s))
        button.props(f"flat dense round size=sm data-at={at_s:.3f}")
        button.set_enabled(self._page.role is Role.OPERATOR)
        button.props["aria-label"] = button.props["title"] = f"{text}, at {at_s:.1f} s"
        button.style(f"position: absolute; left: calc({100 * share:.2f}% - 1rem)")


def changed(state: PlaybackState, control: PlaybackControl) -> PlaybackState:
    """Return the state to which an order leads."""
    state = replace(state, request=control.request)
    match control.command:
        case "pause" | "resume":
            return replace(state, paused=control.command == "pause")
        case "rate":
            return replace(state, rate=control.value)
        case "seek":
            at_ns = state.begin.nanoseconds + round(control.value * 1e9)
            return replace(state, position=Time.from_nanoseconds(at_ns))
        case _:
            return state


def seconds(state: PlaybackState, time_ns: int) -> float:
    """Return the time since the log's beginning, s."""
    return round((time_ns - state.begin.nanoseconds) / 1e9, 3)
