"""Shows the settings of all modules, and changes those that are changeable while the robot runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.show import inline
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.setting_change import SettingRequest
from robbie_mp.station.watch.settings import Entry
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext


class ParametersPanel(Panel):
    """Settings with their types, limits and values."""

    name = "parameters"
    title = "Parameters"
    icon = "tune"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._settings = station.run.settings
        modules = RunPlan.load(station.run.known.folder).modules
        self.given = {
            module.name: {name: inline(value) for name, value in module.settings.items()}
            for module in modules
        }

    def tick(self) -> None:
        """Read the settings that the modules have written to files."""
        if self.is_looked_at:
            self._settings.tick()

    def build(self, page: Page) -> None:
        """Build a list of the modules, as soon as their settings are known."""
        fields: dict[tuple[str, str], SettingField] = {}
        made: dict[str, list[str]] = {}
        area = ui.column().classes("w-full")

        def update() -> None:
            changeable = self._settings.changeable
            names = {module: [*entries] for module, entries in changeable.items()}
            if names != made:
                made.clear()
                made.update(names)
                area.clear()
                fields.clear()
                with area:
                    for module in names:
                        self._build_module(module, changeable[module], page, fields)
            for (module, name), field in fields.items():
                field.update(changeable[module][name])

        page.every(0.2, self.name, update)

    def _build_module(
        self,
        module: str,
        changeable: dict[str, Entry],
        page: Page,
        fields: dict[tuple[str, str], SettingField],
    ) -> None:
        with ui.expansion(module, value=bool(changeable)).classes("w-full").props("dense"):
            for name, entry in changeable.items():
                change = SettingRequest(self._settings, page, module, name)
                fields[module, name] = SettingField(change, page, module, name, entry)
            fixed = {name: value for name, value in self.given[module].items() if name not in changeable}
            for name, value in fixed.items():
                ui.label(f"{name}: {value}").classes("text-grey")
            if not fixed and not changeable:
                ui.label("all settings have their default values").classes("text-grey")


class SettingField:
    """One changeable setting on one page.

    Args:
        change: requests changes of it.
        page: the page. Observers cannot change anything.
        module, name: the setting.
        entry: type, value and description of the setting.
    """

    def __init__(self, change: SettingRequest, page: Page, module: str, name: str, entry: Entry):
        self._change = change
        self._name = name
        key = f"{module}-{name}"
        with ui.row().classes("items-start w-full gap-4"):
            self._value = ui.label().classes("w-48 font-bold q-pt-md").props(f"id=value-{key}")
            self._input: ui.input | None = None
            if page.role is Role.OPERATOR:
                self._input = ui.input(name, value=inline(entry["value"])).classes("w-64")
                self._input.props(f"for=input-{key} id=field-{key}")
                self._input.on("keyup.enter", self._ask)
                ui.button("Set", on_click=self._ask).props(f"id=set-{key}").classes("q-mt-sm")
            with ui.column().classes("gap-0 q-pt-sm"):
                ui.label(entry["description"])
                ui.label(entry["type"]).classes("text-grey")

    def update(self, entry: Entry) -> None:
        """Show the value, and the result of the last change."""
        changed = " (changed)" if entry["changed"] else ""
        self._value.set_text(f"{self._name}: {inline(entry['value'])}{changed}")
        if self._input is not None:
            self._change.look()
            self._input.error = self._change.error or None

    def _ask(self) -> None:
        assert self._input is not None
        self._change.ask(str(self._input.value))
