"""The health of a module: OK, or DEGRADED with its reasons."""

from collections.abc import Callable


class Health:
    """Says each reason once when it begins and once when it ends, and shows those that last.

    Args:
        say: logs a line as a warning.
        show: shows a line on what is wrong, '' if nothing is.
    """

    def __init__(self, say: Callable[[str], None], show: Callable[[str], None] = lambda _line: None):
        self._say = say
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
            self._say(f"DEGRADED: {reason}")
        self._reasons[cause] = reason
        self._show_reasons()

    def recover(self, cause: str, what: str = "") -> None:
        """End a cause.

        Args:
            cause: as given to `degrade`.
            what: what has become right; '': the reason is no longer true.
        """
        if (reason := self._reasons.pop(cause, None)) is not None:
            state = "still DEGRADED" if self._reasons else "OK again"
            self._say(f"{state}: {what}" if what else f"{state} (it was: {reason})")
            self._show_reasons()

    def clear(self) -> None:
        """Forget all reasons, without a word."""
        self._reasons.clear()
        self._show_reasons()

    @property
    def line(self) -> str:
        """What is shown: all reasons; '' if there are none."""
        return self._shown

    def _show_reasons(self) -> None:
        line = "; ".join(self._reasons.values())
        if line != self._shown:
            self._shown = line
            self._show(line)
