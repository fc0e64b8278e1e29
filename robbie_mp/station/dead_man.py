"""The dead man's switch: a command counts only if it is fresh when it arrives."""

STALE_S = 0.25
"""A command is stale if it took longer than the quickest one of this drive by this time."""


class DeadManSwitch:
    """Distinguishes fresh commands from those that a slow link or a stopped server delivers late.

    The clocks of page and robot differ, so the time that a command took is unknown. The quickest command of a
    drive bounds the difference of the clocks, and the others are compared with it.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self.stale = 0
        """Number of commands that arrived too late and were discarded."""

    def begin(self) -> None:
        """Begin a drive: the operator holds the control."""
        self._offset_s = None

    def accept(self, sent_s: float, now_s: float) -> bool:
        """Return whether a command is fresh.

        Args:
            sent_s: when the page sent it, on the page's monotonic clock.
            now_s: the present time, on the robot's monotonic clock.
        """
        offset_s = now_s - sent_s
        if self._offset_s is None or offset_s < self._offset_s:
            self._offset_s = offset_s
        if offset_s - self._offset_s > STALE_S:
            self.stale += 1
            return False
        return True
