"""Settings that can be changed while the robot runs: what they are, and how a page changes them."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from robbie_mp.messages import SettingChange, SettingChanged
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.run.plan import RunPlan

if TYPE_CHECKING:
    from robbie_mp.station.panel import Page
    from robbie_mp.station.station import OperatorStation

READ_PERIOD_S = 1.0
ANSWER_LIMIT_S = 5.0
ANSWERS = 64
"""So many are kept until their pages look."""
LONGEST_VALUE = 4096
Entry = dict[str, Any]
"""As a SettingsFile holds it: value, type, outline, description, changed."""


class SettingsWatch:
    """Reads what the modules have written down of their settings, and hears what they answer.

    Attributes:
        changeable: by module and setting; replaced and never changed, for other threads look at it.
    """

    def __init__(self, station: OperatorStation):
        self.changeable: dict[str, dict[str, Entry]] = {}
        self._station = station
        names = [module.name for module in RunPlan.load(station.known_run.folder).modules]
        self._files = {name: SettingsFile(station.known_run.folder, name) for name in names}
        self._next_s = 0.0
        self._answers: OrderedDict[int, SettingChanged] = OrderedDict()
        station.hear(SettingChanged, self._on_answer)

    def _on_answer(self, answer: SettingChanged) -> None:
        self._next_s = 0.0
        self._answers[answer.request] = answer
        while len(self._answers) > ANSWERS:
            self._answers.popitem(last=False)

    def tick(self) -> None:
        """Read what has changed, if that is due; panels that are looked at have it done."""
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + READ_PERIOD_S
            self.changeable = {name: file.read() for name, file in self._files.items()}

    def take_answer(self, request: int) -> SettingChanged | None:
        """Return what a module has answered to a request, once."""
        return self._answers.pop(request, None)


class Change:
    """One setting on one page: asks for changes, and tells what has become of them.

    Args:
        station: hears the answers.
        page: of who asks.
        module, name: which setting.

    Attributes:
        error: what was wrong with the last one; '' if nothing is known to be.
    """

    def __init__(self, station: OperatorStation, page: Page, module: str, name: str):
        self.error = ""
        self._page = page
        self._station = station
        self._module = module
        self._name = name
        self._request: int | None = None
        self._asked_s = 0.0

    @property
    def is_open(self) -> bool:
        """Whether the module has not answered yet."""
        return self._request is not None

    def ask(self, value: str) -> None:
        """Ask the module to change it.

        Args:
            value: in YAML.
        """
        self.error, self._request = "", None
        if len(value) > LONGEST_VALUE:
            self.error = f"at most {LONGEST_VALUE} characters"
            return
        request, self._asked_s = secrets.randbits(63), time.monotonic()
        change = SettingChange(request=request, setting=self._name, value=value)
        if self._page.publish(change, "the change", self._module):
            self._request = request
        else:
            self.error = "not sent"

    def look(self) -> None:
        """See whether the module has answered."""
        if self._request is None:
            return
        answer = self._station.settings_watch.take_answer(self._request)
        if answer is not None:
            self._request = None
            self.error = answer.error
        elif time.monotonic() - self._asked_s > ANSWER_LIMIT_S:
            self.error = f"no answer yet; {self._module} changes it when it comes to it"
