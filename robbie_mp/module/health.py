"""The health of a module: OK, or DEGRADED with its reasons."""

import logging
from collections.abc import Callable


class Health:
    """Logs each reason once when it begins and once when it ends, and shows those that last.

    Args:
        log: the module's logger.
        show: shows a line on what is wrong, '' if nothing is.
    """

    def __init__(self, log: logging.Logger, show: Callable[[str], None] = lambda _line: None):
        self._log = log
        self._show = show
        self._reasons: dict[str, str] = {}
        self._shown = ""

    def degrade(self, cause: str, reason: str) -> None:
        """Begin or go on to be DEGRADED for a cause.

        Args:
            cause: names the cause for `recover`.
            reason: what is wrong, as it is now.
        """
        if cause not in self._reasons:
            self._log.warning("DEGRADED: %s", reason)
        self._reasons[cause] = reason
        self._show_reasons()

    def recover(self, cause: str, what: str) -> None:
        """End a cause.

        Args:
            cause: as given to `degrade`.
            what: what has become right.
        """
        if self._reasons.pop(cause, None) is not None:
            self._log.warning("%s: %s", "still DEGRADED" if self._reasons else "OK again", what)
            self._show_reasons()

    def _show_reasons(self) -> None:
        line = "; ".join(self._reasons.values())
        if line != self._shown:
            self._shown = line
            self._show(line)
