"""Changes settings while their module runs.

`robbie param set` publishes a `SettingChange` on a topic with the module's name. The module handles it like
any other message: it checks the value like one from a profile, sets the attribute, calls
`Module.setting_changed`, and answers with a `SettingChanged`. It also writes the changed settings to the
run's folder, so that the module's next incarnation starts with them.
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
    """The module has no such setting, or the setting cannot be changed while the module runs."""


class SettingsFile:
    """The file in the run's folder with a module's settings and their values: the module writes it.

    Args:
        run_folder: the run's folder.
        module: the module's name.
    """

    def __init__(self, run_folder: Path, module: str):
        self._path = run_folder / FOLDER / f"{module}.json"

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

    def changed(self) -> dict[str, Any]:
        """Return the values that were changed in this run."""
        return {name: entry["value"] for name, entry in self.read().items() if entry["changed"]}

    def write(self, settings: Mapping[str, dict[str, Any]]) -> None:
        """Replace the file in one step: readers see the old or the new content, even if this process dies.

        Raises:
            OSError: the file cannot be written.
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
            name: _entry(one, getattr(module, name), changed=False)
            for name, one in declared.items()
            if not one.changeable and file is not None
        }
        self._changed = set(file.changed()) if file is not None else set()
        self._log = logging.getLogger(module.name)

    def listen(self) -> None:
        """Write the settings, and subscribe to requests for changes if any can be changed."""
        if self._settings or self._fixed:
            self._keep()
        if self._settings:
            self._bus.subscriptions.subscribe(
                SettingChange, self._on_change, MessageHandling.ALWAYS_DELIVER, self._module.name
            )

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
        from robbie_mp.profile.reader import read_text  # noqa: PLC0415 - most modules never get a request

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
        changeable = {
            name: _entry(declared, getattr(self._module, name), changed=name in self._changed)
            for name, declared in self._settings.items()
        }
        try:
            self._file.write(self._fixed | changeable)
        except OSError as error:
            self._log.warning("changed settings will be lost at a restart: %s", error)


def _entry(declared: Setting, value: object, *, changed: bool) -> dict[str, Any]:
    """Describe a setting; the text of a secret is where it is kept."""
    return {
        "value": value,
        "type": declared.describe(),
        "outline": declared.outline(),
        "description": declared.description,
        "changeable": declared.changeable,
        "changed": changed,
    }
