"""Changes settings while their module runs.

`robbie param set` publishes a `SettingChange` on a topic with the module's name. The module handles it like
any other message: it checks the value like one from a profile, sets the attribute, calls
`Module.setting_changed`, and answers with a `SettingChanged`. It also writes the changed settings to the
run's folder, so that the module's next incarnation starts with them.

A changed value is on trial until the module has run with it for `TRIAL_S`, and again in the first `setup()`
with it. If the process dies meanwhile, its successor takes the value back, and says so. A module that does
not run takes a change at its next start: then the value waits in a file of its own.
"""

import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.base.problem import ProfileError
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.bus import Bus
from robbie_mp.module.module import MessageHandling, Module, calls_of, health_of
from robbie_mp.module.settings import Setting, SettingError, settings_of

FOLDER = "settings"
TRIAL_S = 5.0
"""How long a module must run with a changed value before a death is no reason to take it back."""


class NotChangeable(RobbieError, LookupError):
    """The module has no such setting, or the setting cannot be changed while the module runs."""


@dataclass(frozen=True)
class Change:
    """A value that was changed in this run."""

    value: Any
    before: Sequence[Any] = ()
    """The changed value that it replaced; empty if it replaced the profile's."""
    is_on_trial: bool = True
    has_started: bool = False
    """Whether a process has started with it and lived."""


@dataclass(frozen=True)
class Start:
    """The changed values with which a process starts."""

    changes: Mapping[str, Change]
    taken_back: Mapping[str, Any]
    """Values with which the process before died."""

    @property
    def values(self) -> dict[str, Any]:
        """The value of each changed setting."""
        return {name: change.value for name, change in self.changes.items()}


class SettingsFile:
    """The file in the run's folder with a module's settings and their values: the module writes it.

    Beside it lie the values that wait for the module's next start, which others write.

    Args:
        run_folder: the run's folder.
        module: the module's name.
    """

    def __init__(self, run_folder: Path, module: str):
        self._path = run_folder / FOLDER / f"{module}.json"
        self._waiting = run_folder / FOLDER / "next_start" / module

    def read(self) -> dict[str, dict[str, Any]]:
        """Return an entry for each setting; empty if the module has none, or never ran."""
        try:
            content: dict[str, dict[str, Any]] = json.loads(self._path.read_text())
        except (OSError, ValueError):
            return {}
        return content

    def read_changeable(self) -> dict[str, dict[str, Any]]:
        """Return an entry for each setting that can be changed while the module runs."""
        return {name: entry for name, entry in self.read().items() if entry["changeable"]}

    def start(self) -> Start:
        """Return the values that were changed in this run, without those with which the last process died."""
        entries = self.read().items()
        found = {name: Change(**entry["change"]) for name, entry in entries if entry["changed"]}
        changes: dict[str, Change] = {}
        for name, change in found.items():
            if not change.is_on_trial:
                changes[name] = replace(change, is_on_trial=not change.has_started)
            elif change.before:
                changes[name] = Change(change.before[0])
        return Start(changes, {name: change.value for name, change in found.items() if change.is_on_trial})

    def wait_for_start(self, setting: str, text: str) -> None:
        """Leave a value for the module's next start.

        Args:
            setting: the setting.
            text: its value in YAML.
        """
        make_private_folder(self._waiting)
        write_private(self._waiting / setting, text)

    def withdraw(self, setting: str) -> bool:
        """Remove a value that waits for the module's next start; False if there is none any more."""
        try:
            (self._waiting / setting).unlink()
        except FileNotFoundError:
            return False
        return True

    def waiting(self) -> dict[str, str]:
        """Return the values that wait for the module's start, in YAML, by their settings."""
        found = {}
        for path in self._waiting.glob("[!.]*"):
            with suppress(FileNotFoundError):  # it has just been withdrawn
                found[path.name] = path.read_text()
        return found

    def write(self, settings: Mapping[str, dict[str, Any]]) -> None:
        """Replace the file in one step: readers see the old or the new content, even if this process dies.

        Raises:
            OSError: the file cannot be written.
        """
        make_private_folder(self._path.parent)
        write_private(self._path, json.dumps(settings, default=str))


class SettingChanges:
    """Changes the settings of one module.

    Args:
        module: the module.
        bus: its bus.
        file: where the module's next incarnation finds the changed settings; None: nowhere.
    """

    def __init__(self, module: Module, bus: Bus, file: SettingsFile | None = None):
        self._module = module
        self._bus = bus
        self._file = file
        declared = settings_of(type(module))
        self._settings = {name: one for name, one in declared.items() if one.changeable}
        # Read now, because `setup()` may reuse the attributes; the others are read when the file is written.
        self._fixed = {
            name: _entry(one, getattr(module, name))
            for name, one in declared.items()
            if not one.changeable and file is not None
        }
        self._start = Start({}, {}) if file is None else file.start()
        self._changes = dict(self._start.changes)
        self._calls = calls_of(module)
        self._health = health_of(module)
        self._is_running = False
        self._log = logging.getLogger(module.name)

    def listen(self) -> None:
        """Write the settings, and subscribe to requests for changes if any can be changed.

        Values that wait for the module's start are set before `setup()`.
        """
        for name, value in self._start.taken_back.items():
            self._log.error("%s", self._why_taken_back(name, value))
            self._health.degrade(f"setting {name}", self._why_taken_back(name, value))
        self._take_waiting()
        if self._settings or self._fixed:
            self._keep()
        if self._settings:
            self._bus.subscriptions.subscribe(
                SettingChange, self._on_change, MessageHandling.ALWAYS_DELIVER, self._module.name
            )

    def begin(self) -> None:
        """Tell which values were taken back, and try those that the module has never run with: it runs."""
        self._is_running = True
        for name, value in self._start.taken_back.items():
            self._answer(0, name, self._why_taken_back(name, value))
        self._survive(name for name, change in self._start.changes.items() if self._changes[name] is change)
        self._try(name for name, change in self._changes.items() if change.is_on_trial)
        self._take_waiting()

    def end(self) -> None:
        """End all trials: the module is stopped cleanly, so no value has killed it."""
        self._survive(self._changes)

    def change(self, name: str, value: object) -> Any:
        """Check a value, set it, and let the module apply it.

        Returns:
            The value as its declared type.

        Raises:
            NotChangeable: the module has no changeable setting of this name.
            SettingError: the value does not fit, or the module refuses it; nothing is changed.
        """
        module = self._module
        declared = self._settings.get(name)
        if declared is None:
            names = ", ".join(self._settings) or "none"
            raise NotChangeable(f"{module.name} has no setting {name!r} that can be changed; it has {names}")
        checked = self._check(declared, name, value)
        old = getattr(module, name)
        setattr(module, name, checked)
        try:
            module.setting_changed(name)
        except SettingError:
            setattr(module, name, old)
            raise
        self._note(Change(checked), name)
        self._try([name])
        self._log.info("setting %s was changed from %s to %s", name, old, checked)
        return checked

    def _check(self, declared: Setting, name: str, value: object) -> Any:
        module, checked = self._module, declared.check(value)
        type(module).check({key: getattr(module, key) for key in settings_of(type(module))} | {name: checked})
        return checked

    def _note(self, change: Change, name: str) -> None:
        known = self._changes.get(name)
        before = () if known is None else known.before if known.is_on_trial else (known.value,)
        self._changes[name] = replace(change, before=before)
        self._keep()
        self._health.recover(f"setting {name}", f"setting {name} was changed again")

    def _take_waiting(self) -> None:
        """Take the values that were to wait until the module starts; a later one replaces an earlier one."""
        if self._file is None:
            return
        for name, text in self._file.waiting().items():
            try:
                self._take(name, _read(text, name))
            except (SettingError, NotChangeable, ProfileError) as refusal:
                self._log.error("a value that waited for this start is not used: %s", refusal)
            self._file.withdraw(name)

    def _take(self, name: str, value: object) -> None:
        if self._is_running or name not in self._settings:
            self.change(name, value)
            return
        checked = self._check(self._settings[name], name, value)
        setattr(self._module, name, checked)
        self._note(Change(checked, has_started=True), name)
        self._log.info("setting %s is %s from this start on", name, checked)

    def _try(self, names: Iterable[str]) -> None:
        """Have changed values survive if the module runs with them for long enough."""
        tried = {name: self._changes[name] for name in names}
        if self._is_running and tried:
            self._calls.call_later(
                TRIAL_S,
                lambda: self._survive(
                    name for name, change in tried.items() if self._changes[name] is change
                ),
            )

    def _survive(self, names: Iterable[str]) -> None:
        tried = {name: self._changes[name] for name in names if self._changes[name].is_on_trial}
        for name, change in tried.items():
            started = change.has_started or change is self._start.changes.get(name)
            self._changes[name] = replace(change, is_on_trial=False, has_started=started)
        if tried:
            self._keep()

    def _why_taken_back(self, name: str, value: object) -> str:
        present = getattr(self._module, name, None)
        return (
            f"setting {name} was taken back from {value} to {present}: "
            f"the module died before it had run with it for {TRIAL_S:g} s"
        )

    def _on_change(self, asked: SettingChange) -> None:
        error = ""
        try:
            self.change(asked.setting, _read(asked.value, asked.setting))
        except (SettingError, NotChangeable, ProfileError) as refusal:
            error = str(refusal)
        self._answer(asked.request, asked.setting, error)

    def _answer(self, request: int, setting: str, error: str) -> None:
        value = str(getattr(self._module, setting, "")) if setting in self._settings else ""
        answer = SettingChanged(
            request=request, module=self._module.name, setting=setting, value=value, error=error
        )
        self._bus.publish(answer, self._module.name)

    def _keep(self) -> None:
        if self._file is None:
            return
        changeable = {
            name: _entry(declared, getattr(self._module, name), self._changes.get(name))
            for name, declared in self._settings.items()
        }
        try:
            self._file.write(self._fixed | changeable)
        except OSError as error:
            self._log.warning("changed settings will be lost at a restart: %s", error)


def _read(text: str, setting: str) -> Any:
    """Read a value in YAML; ProfileError: it is none."""
    from robbie_mp.base.yaml_reader import read_text  # noqa: PLC0415 - most modules never get a request

    return read_text(text, setting).plain()


def _entry(declared: Setting, value: object, change: Change | None = None) -> dict[str, Any]:
    """Describe a setting; the text of a secret is where it is kept."""
    return {
        "value": value,
        "type": declared.describe(),
        "outline": declared.outline(),
        "description": declared.description,
        "changeable": declared.changeable,
        "changed": change is not None,
        **({"change": {**asdict(change), "value": value}} if change else {}),
    }
