"""Logs a warning about messages once, not for every message."""

import logging

LIMIT = 100
"""Most different warnings."""


class WarnOnce:
    """Logs each warning once.

    Args:
        log: where to log.
    """

    def __init__(self, log: logging.Logger):
        self._log = log
        self._said: set[str] = set()
        self.ignored = 0
        """How often a message, or a part of one, was ignored."""

    def ignore(self, what: str, why: object) -> None:
        """Count something that is ignored; log the reason if none has been logged for `what`."""
        self.ignored += 1
        self.say(f"{what} is ignored", why)

    def say(self, what: str, text: object) -> None:
        """Log a warning about `what` once; `text` is converted to str only then."""
        if what not in self._said and len(self._said) < LIMIT:
            self._said.add(what)
            self._log.warning("%s: %s (logged once)", what, text)
