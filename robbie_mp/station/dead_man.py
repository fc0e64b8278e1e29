"""The dead man's switch: a command counts only if the control is held now, not if it was when it was sent."""

STALE_S = 0.25
"""A command that took so much longer than the quickest one of this drive was held up on the way."""


class DeadManSwitch:
    """Tells fresh commands from those that a slow link or a server that stood still delivers late.

    The clocks of page and robot are not the same, so nobody knows how long a command took; but the quickest
    one of a drive tells how far the clocks are apart at most, and the others are compared with that.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self.stale = 0
        """Commands that came too late and were thrown away."""

    def begin(self) -> None:
        """Begin a drive: the control is taken hold of."""
        self._offset_s = None

    def accept(self, sent_s: float, now_s: float) -> bool:
        """Whether a command is fresh.

        Args:
            sent_s: when the page sent it, by a clock of the page that never goes back.
            now_s: by one of the robot.
        """
        offset_s = now_s - sent_s
        if self._offset_s is None or offset_s < self._offset_s:
            self._offset_s = offset_s
        if offset_s - self._offset_s > STALE_S:
            self.stale += 1
            return False
        return True
