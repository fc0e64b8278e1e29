"""Settings of all modules; those that may be changed while the robot runs are changed here."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from nicegui import ui

from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.profile.show import inline
from robbie_mp.services.operator_station.access import Role
from robbie_mp.services.operator_station.panel import Page, Panel
from robbie_mp.setting_changes import SettingsFile
from robbie_mp.supervisor.plan import RunPlan

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.station import OperatorStation

READ_PERIOD_S = 1.0
ANSWER_LIMIT_S = 5.0
ANSWERS = 64
"""So many are kept until their pages look."""
LONGEST_VALUE = 4096
HIDDEN = ("token", "password", "secret")
Entry = dict[str, Any]
"""As a SettingsFile holds it: value, type, description, changed."""


class ParametersPanel(Panel):
    """Settings with their types, limits and values."""

    name = "parameters"
    title = "Parameters"
    icon = "tune"

    def __init__(self, station: OperatorStation):
        super().__init__(station)
        modules = RunPlan.load(station.run_folder).modules
        self.given = {module.name: shown_settings(module.settings) for module in modules}
        self._files = {name: SettingsFile(station.run_folder, name) for name in self.given}
        self._next_s = 0.0
        self.changeable: dict[str, dict[str, Entry]] = {}
        self.answers: OrderedDict[int, SettingChanged] = OrderedDict()
        station.hear(SettingChanged, self._on_answer)

    def _on_answer(self, answer: SettingChanged) -> None:
        self._next_s = 0.0
        self.answers[answer.request] = answer
        while len(self.answers) > ANSWERS:
            self.answers.popitem(last=False)

    def tick(self) -> None:
        """Read what the modules have written down."""
        if self.is_looked_at and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + READ_PERIOD_S
            self.changeable = {name: file.read() for name, file in self._files.items()}

    def build(self, page: Page) -> None:
        """Make a list of the modules, as soon as it is known what they have."""
        fields: dict[tuple[str, str], Field] = {}
        made: dict[str, list[str]] = {}
        area = ui.column().classes("w-full")

        def update() -> None:
            names = {module: [*entries] for module, entries in self.changeable.items()}
            if names != made:
                made.clear()
                made.update(names)
                area.clear()
                fields.clear()
                with area:
                    for module in names:
                        self._build_module(module, page, fields)
            for (module, name), field in fields.items():
                field.update(self.changeable[module][name])

        page.every(0.2, self.name, update)

    def _build_module(self, module: str, page: Page, fields: dict[tuple[str, str], Field]) -> None:
        changeable = self.changeable[module]
        with ui.expansion(module, value=bool(changeable)).classes("w-full").props("dense"):
            for name, entry in changeable.items():
                fields[module, name] = Field(self, page, module, name, entry)
            fixed = {name: value for name, value in self.given[module].items() if name not in changeable}
            for name, value in fixed.items():
                ui.label(f"{name}: {value}").classes("text-grey")
            if not fixed and not changeable:
                ui.label("all settings have their default values").classes("text-grey")


class Field:
    """One setting that can be changed, on one page.

    Args:
        panel: knows values and answers.
        page: observers only look.
        module, name: which it is.
        entry: what is known of it.
    """

    def __init__(self, panel: ParametersPanel, page: Page, module: str, name: str, entry: Entry):
        self._panel = panel
        self._module = module
        self._name = name
        self._request: int | None = None
        self._asked_s = 0.0
        key = f"{module}-{name}"
        with ui.row().classes("items-start w-full gap-4"):
            self._value = ui.label().classes("w-48 font-bold q-pt-md").props(f"id=value-{key}")
            self._input: ui.input | None = None
            if page.role is Role.OPERATOR:
                self._input = ui.input(name, value=inline(entry["value"])).classes("w-64")
                self._input.props(f"for=input-{key} id=field-{key}")
                self._input.on("keydown.enter", self._ask)
                ui.button("Set", on_click=self._ask).props(f"id=set-{key}").classes("q-mt-sm")
            with ui.column().classes("gap-0 q-pt-sm"):
                ui.label(entry["description"])
                ui.label(entry["type"]).classes("text-grey")

    def update(self, entry: Entry) -> None:
        """Show the value, and what has become of a change."""
        changed = " (changed)" if entry["changed"] else ""
        self._value.set_text(f"{self._name}: {inline(entry['value'])}{changed}")
        if self._request is None or self._input is None:
            return
        answer = self._panel.answers.pop(self._request, None)
        if answer is not None:
            self._request = None
            self._input.error = answer.error or None
        elif time.monotonic() - self._asked_s > ANSWER_LIMIT_S:
            self._input.error = f"no answer yet; {self._module} changes it when it comes to it"

    def _ask(self) -> None:
        assert self._input is not None
        value = str(self._input.value)
        if len(value) > LONGEST_VALUE:
            self._input.error = f"at most {LONGEST_VALUE} characters"
            return
        self._request, self._asked_s = secrets.randbits(63), time.monotonic()
        change = SettingChange(request=self._request, setting=self._name, value=value)
        self._input.error = None
        if not self._panel.station.publish(change, topic=self._module):
            self._request = None
            self._input.error = "not sent: the robot's memory is full"


def shown_settings(settings: dict[str, Any]) -> dict[str, str]:
    """Return settings as text, without what is nobody's business."""
    return {
        name: "…" if any(word in name for word in HIDDEN) else inline(value)
        for name, value in settings.items()
    }
