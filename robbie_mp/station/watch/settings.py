"""Settings that can be changed while the robot runs, and the modules' answers to changes."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from robbie_mp.messages import SettingChanged
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.plan import RunPlan

if TYPE_CHECKING:
    from pathlib import Path

    from robbie_mp.station.watch.latest import MessageSource

READ_PERIOD_S = 1.0
MAX_ANSWERS = 64
"""Maximum number of answers that wait until their pages read them."""
Entry = dict[str, Any]
"""A setting as in a SettingsFile: value, type, outline, description, changeable, changed."""


class SettingsWatch:
    """Reads the files in which modules describe their settings, and receives their answers to changes.

    Attributes:
        changeable: settings by module and name. The dict is replaced and never changed, because other threads
            read it.
    """

    def __init__(self, source: MessageSource, run_folder: Path):
        self.changeable: dict[str, dict[str, Entry]] = {}
        names = [module.name for module in RunPlan.load(run_folder).modules]
        self._files = {name: SettingsFile(run_folder, name) for name in names}
        self._next_s = 0.0
        self._answers: OrderedDict[int, SettingChanged] = OrderedDict()
        source.hear(SettingChanged, self._on_answer)

    def _on_answer(self, answer: SettingChanged) -> None:
        self._next_s = 0.0
        self._answers[answer.request] = answer
        while len(self._answers) > MAX_ANSWERS:
            self._answers.popitem(last=False)

    def tick(self) -> None:
        """Read the files again if that is due. Panels that a page shows call this."""
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + READ_PERIOD_S
            self.changeable = {name: file.read_changeable() for name, file in self._files.items()}

    def take_answer(self, request: int) -> SettingChanged | None:
        """Return a module's answer to a request, once."""
        return self._answers.pop(request, None)
