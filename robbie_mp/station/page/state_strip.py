"""The strip at the top of the page: what an operator must know at any time, in every layout."""

from __future__ import annotations

import math
import shutil
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.attached.views.run_figures import state_name
from robbie_mp.messages import BatteryState, LinkState
from robbie_mp.station.page.alarms import Alarms, causes_of
from robbie_mp.station.page.state_item import ALERT, GOOD, UNKNOWN, WARNING, StateItem, clock_text

if TYPE_CHECKING:
    from robbie_mp.bus.observe import ModuleFigures, RunReading
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.panel import Panel

PERIOD_S = 0.5
RESTARTS_S = 60.0
"""Time for which the strip counts restarts."""
LOW_CHARGE = 0.2
LOW_TIME_S = 300.0
OLD_S = 10.0
"""A battery or link that has been silent for this time is not known."""
BUSY_PERCENT = 90.0
LITTLE_MEMORY = 0.05
LITTLE_DISK_BYTES = 1e9
MAX_LOSS = 0.2
LOGGER, MISSION = "logger", "mission"
"""Names of the modules whose state is shown; the stock parent `recorded` has this logger."""


class StateStrip:
    """The strip of all pages.

    Args:
        station: source of messages and figures.
        panels: add their own items, or replace one of the strip's of the same name.
        is_always_wanted: whether the items are wanted although no page is open.
    """

    def __init__(
        self, station: StationContext, panels: Sequence[Panel] = (), *, is_always_wanted: bool = False
    ):
        self._run = station.run
        self._operators = station.operators
        self._panels = panels
        self._battery = station.messages.newest(BatteryState)
        self._link = station.messages.newest(LinkState)
        self._now_s = station.robot.births.now_s
        self._charges: deque[tuple[float, float]] = deque(maxlen=600)
        self._charges_count = 0
        self._restarts: deque[tuple[float, int]] = deque(maxlen=round(RESTARTS_S / PERIOD_S) * 4)
        self._looked_s = 0.0
        self._is_always_wanted = is_always_wanted
        self.items: tuple[StateItem, ...] = ()
        """The tuple is replaced and never changed, because pages read it."""
        self.alarms = Alarms()

    def tick(self) -> None:
        """Work out the items, once for all pages."""
        is_wanted = self._is_always_wanted or self._operators.pages
        if not is_wanted or time.monotonic() - self._looked_s < PERIOD_S:
            return
        self._looked_s = time.monotonic()
        items = {item.name: item for item in self._look()}
        for panel in self._panels:
            items |= {item.name: item for item in panel.state_items()}
        self.items = tuple(items.values())
        if (reading := self._run.figures.reading) is not None:
            self.alarms.look(causes_of(reading.modules, self.items))

    def build(self, page: Page) -> None:
        """Build the strip of a page."""
        chips: dict[str, Chip] = {}
        strip = ui.element("div").classes("state-strip")
        strip.props('id=state-strip role=group aria-label="State"')

        def update() -> None:
            for item in self.items:
                if item.name not in chips:
                    with strip:
                        chips[item.name] = Chip(item.name)
                chips[item.name].show(item)

        page.always(PERIOD_S, update)

    def _look(self) -> Iterator[StateItem]:
        reading = self._run.figures.reading
        if reading is None:
            return
        if not self._run.log_source:  # otherwise that would be said of what plays the log
            yield from self._module_items(reading)
        if self._battery.message is not None:
            yield self._battery_item(self._battery.message)
        if self._link.message is not None:
            yield self._link_item(self._link.message)
        if not self._run.log_source:
            yield self._machine_item(reading)
        yield self._restarts_item(reading.modules)
        if not self._run.log_source:
            yield self._recording_item(reading.modules)

    def _module_items(self, reading: RunReading) -> Iterator[StateItem]:
        began_ns = min((one.started_ns for one in reading.modules if one.started_ns), default=reading.at_ns)
        yield StateItem(
            "time", "schedule", clock_text((reading.at_ns - began_ns) / 1e9), detail="time of the run"
        )
        for module in reading.modules:
            if module.name == MISSION and module.states:
                yield StateItem("mission", "flag", module.states[:24], detail=module.status)

    def _machine_item(self, reading: RunReading) -> StateItem:
        rates = self._run.figures.rates
        percents = rates.cpu_percent if rates else ()
        machine = reading.machine
        used = 1 - machine.memory_available_bytes / max(1, machine.memory_total_bytes)
        mean = sum(percents) / len(percents) if percents else 0.0
        look = ALERT if used > 1 - LITTLE_MEMORY else WARNING if mean > BUSY_PERCENT else GOOD
        text = f"cpu {mean:.0f}% mem {used:.0%}"
        alarm = f"The robot's computer is short of memory: {used:.0%} are used." if look == ALERT else ""
        return StateItem("machine", "memory", text, look, "processors and memory of the robot", alarm)

    def _battery_item(self, state: BatteryState) -> StateItem:
        if (self._battery.age_s or 0.0) > OLD_S:
            return StateItem(
                "battery",
                "battery_unknown",
                "silent",
                ALERT,
                "the battery has not reported for long",
                f"The battery has been silent for more than {OLD_S:.0f} s.",
            )
        if self._battery.count != self._charges_count and math.isfinite(state.percentage):
            self._charges_count = self._battery.count
            self._charges.append((self._now_s(), state.percentage))
        left_s = time_left_s(self._charges)
        left = f" {clock_text(left_s)}" if left_s is not None and left_s < 360_000 else ""
        low = state.percentage < LOW_CHARGE or (left_s is not None and left_s < LOW_TIME_S)
        icon = "battery_alert" if low else "battery_full"
        detail = f"{state.voltage:.1f} V; the time is what is left as the charge falls now"
        alarm = f"The battery is low: {state.percentage:.0%}{left and f', for {left.strip()}'}."
        return StateItem(
            "battery", icon, f"{state.percentage:.0%}{left}", ALERT if low else GOOD, detail, alarm
        )

    def _link_item(self, state: LinkState) -> StateItem:
        if (self._link.age_s or 0.0) > OLD_S or not state.peers:
            return StateItem("link", "link_off", "no link", UNKNOWN, "no other robot has been heard")
        worst = max(state.peers, key=lambda peer: (not peer.is_up, peer.loss, peer.round_trip_s))
        if not worst.is_up:
            return StateItem(
                "link",
                "link_off",
                f"{worst.robot} lost"[:24],
                ALERT,
                "the other robot is not heard",
                f"The link to {worst.robot} is down.",
            )
        age = "" if math.isnan(worst.newest_state_age_s) else f", data {worst.newest_state_age_s:.1f} s old"
        loss = 0.0 if math.isnan(worst.loss) else worst.loss
        trip = "" if math.isnan(worst.round_trip_s) else f"{1000 * worst.round_trip_s:.0f} ms "
        refused = sum(one.refused for one in state.ill_formed)
        ill = f"; {refused} ill-formed messages refused" if refused else ""
        detail = f"link with {worst.robot}: round trip, loss{age}{ill}"
        alarm = f"The link to {worst.robot} loses {loss:.0%}."
        look = ALERT if loss > MAX_LOSS else GOOD
        return StateItem("link", "link", f"{trip}{loss:.0%} lost", look, detail, alarm)

    def _restarts_item(self, modules: tuple[ModuleFigures, ...]) -> StateItem:
        now_s = time.monotonic()
        self._restarts.append((now_s, sum(one.restarts for one in modules)))
        while now_s - self._restarts[0][0] > RESTARTS_S:
            self._restarts.popleft()
        count = self._restarts[-1][1] - self._restarts[0][1]
        return health_item(modules, count)

    def _recording_item(self, modules: tuple[ModuleFigures, ...]) -> StateItem:
        free = shutil.disk_usage(self._run.output_directory).free
        is_recording = bool(self._run.recorder.name) or any(one.name == LOGGER and one.pid for one in modules)
        text = f"{'REC ' if is_recording else ''}{bytes_text(free)} free"
        icon = "fiber_manual_record" if is_recording else "save"
        detail = "records" if is_recording else "nothing is recorded"
        look = ALERT if free < LITTLE_DISK_BYTES else GOOD
        alarm = f"The robot's disk is almost full: {bytes_text(free)} are free."
        return StateItem("disk", icon, text, look, f"{detail}; free disk", alarm)


class Chip:
    """An item on one page."""

    def __init__(self, name: str):
        with ui.element("div").classes("state-chip").props(f"id=state-{name}") as self._chip:
            self._icon = ui.icon("")
            self._text = ui.label("")
        self._shown: StateItem | None = None

    def show(self, item: StateItem) -> None:
        """Show an item, if it has changed."""
        if item == self._shown:
            return
        before, self._shown = self._shown, item
        self._icon.set_name(item.icon)
        self._text.set_text(item.text)
        if before is None or before.look != item.look:
            self._chip.classes(add=item.look, remove=before.look if before else "")
        if before is None or before.detail != item.detail:
            self._chip.props["title"] = item.detail
            self._chip.update()


def health_item(modules: Sequence[ModuleFigures], restarts: int) -> StateItem:
    """Return which modules are FAILED or DEGRADED, or that none is.

    Args:
        modules: the figures of all.
        restarts: in the last minute.
    """
    failed = [one.name for one in modules if state_name(one) == "FAILED"]
    if failed:
        return StateItem("restarts", "restart_alt", f"{', '.join(failed)[:20]} FAILED", ALERT)
    degraded = {one.name: one.health for one in modules if one.health}
    if degraded:
        detail = "; ".join(f"{name}: {why}" for name, why in degraded.items())
        return StateItem("restarts", "restart_alt", f"{', '.join(degraded)[:20]} DEGRADED", WARNING, detail)
    return StateItem("restarts", "restart_alt", f"{restarts} restarts", detail="restarts in the last minute")


def time_left_s(charges: deque[tuple[float, float]]) -> float | None:
    """Return how long a battery lasts if its charge falls as in the last minutes; None if it does not fall.

    Args:
        charges: times in s and charges from 0 to 1, the oldest first.
    """
    if len(charges) < 2:
        return None
    (begin_s, first), (end_s, last) = charges[0], charges[-1]
    if end_s - begin_s < 20.0 or first - last < 0.002:
        return None
    return last * (end_s - begin_s) / (first - last)


def bytes_text(size: float) -> str:
    """Return a number of bytes with a unit, such as 12 GB."""
    return f"{size / 1e9:.0f} GB" if size >= 1e10 else f"{size / 1e9:.1f} GB"
