"""Says what is wrong with messages once, and not with every message."""

import logging

LIMIT = 100
"""Different warnings; whoever has so many knows."""


class WarnOnce:
    """Warns of each thing once.

    Args:
        log: where to.
    """

    def __init__(self, log: logging.Logger):
        self._log = log
        self._said: set[str] = set()
        self.ignored = 0
        """How often a message, or a part of one, was ignored."""

    def ignore(self, what: str, why: object) -> None:
        """Count something that is ignored, and say why if that has not been said of `what`."""
        self.ignored += 1
        self.say(f"{what} is ignored", why)

    def say(self, what: str, text: object) -> None:
        """Say something of `what`, once; `text` is made a text only then."""
        if what not in self._said and len(self._said) < LIMIT:
            self._said.add(what)
            self._log.warning("%s: %s (said once)", what, text)
