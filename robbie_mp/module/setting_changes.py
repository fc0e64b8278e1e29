"""Settings changed while their module runs: asked for by a message, checked and taken into use by the module.

`robbie param set` publishes a `SettingChange` on the topic that is the module's name. The module handles it
like any other message, between two others: it checks the value as a profile's, sets the attribute, calls
`Module.setting_changed`, and answers with a `SettingChanged`. What was changed is also kept in the run's
folder, so that the module's next incarnation starts with it.
"""

import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robbie_mp.errors import RobbieError
from robbie_mp.linux.private_files import make_private_folder, write_private
from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.bus import Bus
from robbie_mp.module.module import MessageHandling, Module
from robbie_mp.module.settings import Setting, SettingError, settings_of
from robbie_mp.profile.problem import ProfileError

FOLDER = "settings"


class NotChangeable(RobbieError, LookupError):
    """A module has no such setting, or it cannot be changed while the module runs."""


class SettingsFile:
    """A module's changeable settings in the folder of its run: written by the module alone, read by tools.

    Args:
        run_folder: the run's folder.
        module: its name.
    """

    def __init__(self, run_folder: Path, module: str):
        self._path = run_folder / FOLDER / f"{module}.json"

    def read(self) -> dict[str, dict[str, Any]]:
        """Return what is known of each changeable setting; nothing if the module has none, or never ran."""
        try:
            content: dict[str, dict[str, Any]] = json.loads(self._path.read_text())
        except (OSError, ValueError):
            return {}
        return content

    def changed(self) -> dict[str, Any]:
        """Return the values that were changed in this run."""
        return {name: entry["value"] for name, entry in self.read().items() if entry["changed"]}

    def write(self, settings: Mapping[str, dict[str, Any]]) -> None:
        """Replace the whole file; a reader, or a death, sees the old one or the new one.

        Raises:
            OSError: there is no room.
        """
        make_private_folder(self._path.parent)
        unfinished = self._path.with_suffix(f".{os.getpid()}")
        write_private(unfinished, json.dumps(settings, default=str))
        unfinished.rename(self._path)


class SettingChanges:
    """Changes the settings of one module.

    Args:
        module: the module.
        bus: its bus.
        file: where its next incarnation finds what was changed; None: nowhere.
    """

    def __init__(self, module: Module, bus: Bus, file: SettingsFile | None = None):
        self._module = module
        self._bus = bus
        self._file = file
        self._settings = changeable_settings(type(module))
        self._changed = set(file.changed()) if file is not None else set()
        self._log = logging.getLogger(module.name)

    def listen(self) -> None:
        """Have changes asked for handled, if there is anything to change."""
        if self._settings:
            self._keep()
            self._bus.subscriptions.subscribe(
                SettingChange, self._on_change, MessageHandling.ALWAYS_DELIVER, self._module.name
            )

    def change(self, name: str, value: object) -> Any:
        """Check a value, set it, and let the module take it into use; return it as its type.

        Raises:
            NotChangeable: there is no such setting to change.
            SettingError: the value does not fit, or the module refuses it; nothing is changed.
        """
        module = self._module
        declared = self._settings.get(name)
        if declared is None:
            names = ", ".join(self._settings) or "none"
            raise NotChangeable(f"{module.name} has no setting {name!r} that can be changed; it has {names}")
        checked = declared.check(value)
        old = getattr(module, name)
        type(module).check({key: getattr(module, key) for key in settings_of(type(module))} | {name: checked})
        setattr(module, name, checked)
        try:
            module.setting_changed(name)
        except SettingError:
            setattr(module, name, old)
            raise
        self._changed.add(name)
        self._keep()
        self._log.info("setting %s was changed from %s to %s", name, old, checked)
        return checked

    def _on_change(self, asked: SettingChange) -> None:
        from robbie_mp.profile.reader import read_text  # noqa: PLC0415 - most modules are never asked

        error = ""
        try:
            self.change(asked.setting, read_text(asked.value, asked.setting).plain())
        except (SettingError, NotChangeable, ProfileError) as refusal:
            error = str(refusal)
        value = str(getattr(self._module, asked.setting, "")) if asked.setting in self._settings else ""
        answer = SettingChanged(
            request=asked.request, module=self._module.name, setting=asked.setting, value=value, error=error
        )
        self._bus.publish(answer, self._module.name)

    def _keep(self) -> None:
        if self._file is None:
            return
        entries = {
            name: {
                "value": getattr(self._module, name),
                "type": declared.describe(),
                "outline": declared.outline(),
                "description": declared.description,
                "changed": name in self._changed,
            }
            for name, declared in self._settings.items()
        }
        try:
            self._file.write(entries)
        except OSError as error:
            self._log.warning("changed settings will be forgotten at a restart: %s", error)


def changeable_settings(module_class: type[Module]) -> dict[str, Setting]:
    """Return the settings of a class that may be changed while it runs."""
    return {name: declared for name, declared in settings_of(module_class).items() if declared.changeable}
