"""Alarms of all pages: what is wrong, in one sentence each, until it is over and an operator has seen it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element

from robbie_mp.attached.views.run_figures import state_name
from robbie_mp.base.utc import time_of_day
from robbie_mp.station.page.state_item import ALERT, WARNING, StateItem
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.bus.observe import ModuleFigures
    from robbie_mp.station.page.page import Page

PERIOD_S = 0.2
MAX_ALARMS = 50
"""Maximum number of alarms; those that have ended are forgotten first."""
STYLE = Path(__file__).parent / "alarms.css"


class AlarmLevel(IntEnum):
    """How urgent an alarm is."""

    NOTE = 1
    """Nothing to do now."""
    CAUTION = 2
    """Something works worse."""
    DANGER = 3
    """Needs a hand now."""


@dataclass(frozen=True)
class AlarmCause:
    """Something that is wrong now."""

    key: str
    """What is wrong, such as `module mapping`; one alarm for each."""
    level: AlarmLevel
    sentence: str
    """What it is, with the name of the module or device."""


@dataclass(frozen=True)
class Alarm:
    """An alarm."""

    cause: AlarmCause
    number: int
    """Increases with each alarm, and when it becomes more urgent."""
    time_s: float
    """When it began, s since 1970."""
    is_active: bool = True
    is_acknowledged: bool = False


class Alarms:
    """All alarms of a station: an alarm stays until it has ended and an operator has acknowledged it."""

    def __init__(self) -> None:
        self.all: tuple[Alarm, ...] = ()
        """The most urgent first. The tuple is replaced and never changed, because pages read it."""
        self._number = 0
        self._lock = threading.Lock()

    def look(self, causes: Iterable[AlarmCause]) -> None:
        """Update the alarms with everything that is wrong now."""
        now = {one.key: one for one in causes}
        with self._lock:
            known = {alarm.cause.key: alarm for alarm in self.all}
            kept = [self._followed(alarm, now.get(key)) for key, alarm in known.items()]
            new = [self._new(one) for key, one in now.items() if key not in known]
            self._put([alarm for alarm in kept if alarm.is_active or not alarm.is_acknowledged] + new)

    def acknowledge(self, number: int) -> None:
        """Record that an operator has seen an alarm."""
        with self._lock:
            seen = [
                replace(alarm, is_acknowledged=True) if alarm.number == number else alarm
                for alarm in self.all
            ]
            self._put([alarm for alarm in seen if alarm.is_active or not alarm.is_acknowledged])

    def _followed(self, alarm: Alarm, now: AlarmCause | None) -> Alarm:
        if now is None:
            return replace(alarm, is_active=False)
        is_worse = now.level > alarm.cause.level or (not alarm.is_active and alarm.is_acknowledged)
        return self._new(now) if is_worse else replace(alarm, cause=now, is_active=True)

    def _new(self, cause: AlarmCause) -> Alarm:
        self._number += 1
        return Alarm(cause, self._number, time.time())

    def _put(self, alarms: list[Alarm]) -> None:
        alarms.sort(key=lambda one: (one.is_acknowledged, not one.is_active, -one.cause.level, -one.number))
        self.all = tuple(alarms[:MAX_ALARMS])


def causes_of(modules: Iterable[ModuleFigures], items: Iterable[StateItem]) -> Iterator[AlarmCause]:
    """Return what is wrong with modules, and what the items of the strip say."""
    for one in modules:
        key = f"module {one.name}"
        if state_name(one) == "FAILED":
            yield AlarmCause(key, AlarmLevel.DANGER, f"Module {one.name} has FAILED and stays ended.")
        elif one.health:
            yield AlarmCause(key, AlarmLevel.CAUTION, f"Module {one.name} is DEGRADED: {one.health}.")
        elif state_name(one) == "BACKOFF":
            yield AlarmCause(key, AlarmLevel.NOTE, f"Module {one.name} has crashed and is being restarted.")
    for item in items:
        if item.alarm and item.look in (WARNING, ALERT):
            level = AlarmLevel.DANGER if item.look == ALERT else AlarmLevel.CAUTION
            yield AlarmCause(item.name, level, item.alarm)


class AlarmLine(Element, component="alarms.js"):
    """Shows the most urgent alarm in a line of fixed size, and all of them on demand; sounds for new ones."""

    def show(self, alarms: list[dict[str, Any]]) -> None:
        """Show these alarms, if they have changed."""
        if self._props.get("alarms") != alarms:
            self._props["alarms"] = alarms
            self.update()


class AlarmBar:
    """The line of all pages.

    Args:
        alarms: the alarms.
    """

    def __init__(self, alarms: Alarms):
        self._alarms = alarms

    def build(self, page: Page) -> None:
        """Build the line of a page. Only an operator can acknowledge."""
        ui.add_css(STYLE)
        line = AlarmLine().props("id=alarms")
        line.props["may"] = page.role is Role.OPERATOR
        line.show(self._shown())
        line.on("acknowledge", partial(self._on_acknowledge, page))
        page.always(PERIOD_S, lambda: line.show(self._shown()))

    def _on_acknowledge(self, page: Page, event: GenericEventArguments) -> None:
        if isinstance(event.args, int) and page.may("the acknowledgement"):
            self._alarms.acknowledge(event.args)

    def _shown(self) -> list[dict[str, Any]]:
        return [
            {
                "number": one.number,
                "level": int(one.cause.level),
                "text": one.cause.sentence,
                "time": time_of_day(one.time_s)[:8],
                "active": one.is_active,
                "acknowledged": one.is_acknowledged,
            }
            for one in self._alarms.all
        ]
