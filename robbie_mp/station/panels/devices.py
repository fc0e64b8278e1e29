"""Virtual devices that you set by hand: a battery's charge, a pressed bumper, a failing laser.

They have settings whose names begin with `virtual_`. Only simulated devices have such settings.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.run.profile.show import inline
from robbie_mp.station.page.page import Page
from robbie_mp.station.page.slider import Slider
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.setting_change import SettingRequest
from robbie_mp.station.watch.settings import Entry
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

PREFIX = "virtual_"
STEPS = 100
"""Number of steps from one end of a slider to the other."""


class DevicesPanel(Panel):
    """Shows and changes the settings of virtual devices."""

    name = "devices"
    title = "Virtual devices"
    icon = "construction"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self.settings, self._figures = station.run.settings, station.run.figures

    def tick(self) -> None:
        """Read the devices' settings."""
        if self.is_looked_at:
            self.settings.tick()

    def found(self) -> dict[str, dict[str, Entry]]:
        """Return the modules of virtual devices, with the settings of each."""
        return {
            module: virtual
            for module, entries in self.settings.changeable.items()
            if (
                virtual := {
                    name: entry
                    for name, entry in entries.items()
                    if name.startswith(PREFIX) and has_control(entry["outline"])
                }
            )
        }

    def build(self, page: Page) -> None:
        """Build a card for each device, as soon as the devices are known."""
        hint = ui.label("this robot has no virtual devices").classes("text-grey")
        area = ui.row().classes("w-full gap-4")
        made: dict[str, Device] = {}

        def update() -> None:
            found = self.found()
            hint.set_visibility(not found)
            if {name: [*entries] for name, entries in found.items()} != {
                name: [*device.controls] for name, device in made.items()
            }:
                made.clear()
                area.clear()
                with area:
                    made.update({name: Device(self, page, name, found[name]) for name in sorted(found)})
            reading = self._figures.reading
            statuses = {one.name: one.status for one in reading.modules} if reading else {}
            for name, device in made.items():
                device.update(found[name], statuses.get(name, ""))

        page.every(0.2, self.name, update)


class Device:
    """One virtual device on one page.

    Args:
        panel: holds the settings.
        page: the page. Observers cannot change anything.
        module: name of the device's module.
        entries: settings of the device.
    """

    def __init__(self, panel: DevicesPanel, page: Page, module: str, entries: dict[str, Entry]):
        with ui.card().classes("w-96"):
            ui.label(module).classes("font-bold")
            self._status = ui.label("").classes("text-sm").props(f"id=device-{module}")
            self.controls = {
                name: Control(
                    SettingRequest(panel.settings, page, module, name), page, f"{module}-{name}", entry
                )
                for name, entry in entries.items()
            }

    def update(self, entries: dict[str, Entry], status: str) -> None:
        """Show the device's status and its settings."""
        self._status.set_text(status)
        for name, control in self.controls.items():
            control.update(entries[name])


class Control:
    """The element for one setting: a slider, a switch, or a choice, according to its type."""

    def __init__(self, change: SettingRequest, page: Page, key: str, entry: Entry):
        self._change = change
        self._shown: Any = None
        ui.label(entry["description"]).classes("text-sm text-grey")
        self._element = _element_for(entry["outline"], self._ask)
        self._element.props(f"id=control-{key}")
        may = page.role is Role.OPERATOR
        self._element.set_enabled(may)
        if may or not isinstance(self._element, ui.select):  # without its field, a list is no control
            self._element.props["aria-label"] = entry["description"]
        self._value = ui.label("").props(f"id=value-{key}")
        self._error = ui.label("").classes("text-negative").props(f"id=error-{key} role=alert")

    def _ask(self, value: Any) -> None:
        if value != self._shown:  # by hand
            self._shown = value
            self._change.ask(json.dumps(value))

    def update(self, entry: Entry) -> None:
        """Show the value if it has changed, and the error of the last change."""
        self._change.look()
        self._error.set_text(self._change.error)
        is_set = entry["value"] not in (None, [])
        self._value.set_text(f"set to {inline(entry['value'])}" if is_set else "not set")
        if not self._change.is_open and entry["value"] not in (None, self._shown):
            self._shown = entry["value"]
            self._element.set_value(entry["value"])


def has_control(outline: dict[str, Any]) -> bool:
    """Return whether there is an element for a type. Other settings are changed as parameters."""
    is_range = outline["minimum"] is not None and outline["maximum"] is not None
    return bool(outline["choices"]) or (not outline["is_list"] and (is_range or outline["kind"] == "bool"))


def _element_for(outline: dict[str, Any], ask: Callable[[Any], None]) -> ui.select | ui.switch | Slider:
    if outline["choices"]:
        choice = ui.select(outline["choices"], multiple=outline["is_list"]).classes("w-full")
        return choice.on_value_change(lambda event: ask(event.value))
    if outline["kind"] == "bool":
        return ui.switch("on").on_value_change(lambda event: ask(event.value))
    low, high = outline["minimum"], outline["maximum"]
    step = (high - low) / STEPS
    if outline["kind"] == "int":
        step = max(1, round(step))
    slider = Slider(min=low, max=high, step=step, value=low).props("label")
    return slider.on_chosen(ask)
