"""Changes a setting of a running module for a page."""

from __future__ import annotations

import secrets
import time
from typing import TYPE_CHECKING

from robbie_mp.messages import SettingChange

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.settings import SettingsWatch

ANSWER_LIMIT_S = 5.0
MAX_VALUE_CHARACTERS = 4096


class SettingRequest:
    """One setting on one page: requests changes, and holds the module's answer.

    Args:
        settings: receives the answers.
        page: publishes the requests.
        module, name: the setting.

    Attributes:
        error: why the last change was refused; '' if it was not.
    """

    def __init__(self, settings: SettingsWatch, page: Page, module: str, name: str):
        self.error = ""
        self._page = page
        self._settings = settings
        self._module = module
        self._name = name
        self._request: int | None = None
        self._asked_s = 0.0

    @property
    def is_open(self) -> bool:
        """Whether the module has not answered yet."""
        return self._request is not None

    def ask(self, value: str) -> None:
        """Request a change from the module.

        Args:
            value: the new value in YAML.
        """
        self.error, self._request = "", None
        if len(value) > MAX_VALUE_CHARACTERS:
            self.error = f"at most {MAX_VALUE_CHARACTERS} characters"
            return
        request, self._asked_s = secrets.randbits(63), time.monotonic()
        change = SettingChange(request=request, setting=self._name, value=value)
        if self._page.publish(change, "the change", self._module):
            self._request = request
        else:
            self.error = "not sent"

    def look(self) -> None:
        """Process the module's answer, if it has arrived."""
        if self._request is None:
            return
        answer = self._settings.take_answer(self._request)
        if answer is not None:
            self._request = None
            self.error = answer.error
        elif time.monotonic() - self._asked_s > ANSWER_LIMIT_S:
            self.error = f"no answer yet; {self._module} changes it when it comes to it"
