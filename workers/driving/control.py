"""Who controls the robot's motion: modules, an operator, or nobody until somebody orders it to go on.

A robot that was stopped, taken over, or left by its operator stands until it gets an order. Releasing the
emergency stop is no such order (ISO 13850, 4.1.4: the reset shall not restart the machine), and neither is a
stick that was held all the time.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any


class ControlMode(IntEnum):
    """Who controls the robot; the numbers are those of the message `ControlState`."""

    AUTO = 0
    MANUAL = 1
    HOLD = 2


class DriveControl:
    """Decides whose commands the robot follows.

    Args:
        clock: returns the time in s; it never goes back.
        mode: how the robot is controlled at the start.
        let_go_s: an operator has let go when no command by hand has come for this time.
        before: what the last process knew, from `memory`.

    Attributes:
        mode: how the robot is controlled.
        who: who caused the last change; '' at the start.
        reason: why it changed.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        mode: ControlMode = ControlMode.AUTO,
        let_go_s: float = 0.5,
        before: dict[str, Any] | None = None,
    ) -> None:
        self._clock = clock
        self._let_go_s = let_go_s
        self._by_hand_s = clock()
        self.mode, self.who, self.reason = mode, "", "the run has started"
        self._stop = False
        self._must_let_go = False
        if before is not None:
            self.mode = ControlMode(before["mode"])
            self.who, self.reason = before["who"], before["reason"]
            self._stop, self._must_let_go = before["stop"], before["must_let_go"]

    def memory(self) -> dict[str, Any]:
        """Return what the next process must know."""
        return {
            "mode": int(self.mode),
            "who": self.who,
            "reason": self.reason,
            "stop": self._stop,
            "must_let_go": self._must_let_go,
        }

    def order(self, mode: ControlMode, who: str, reason: str) -> str:
        """Carry out an order to go on (AUTO) or to stand (HOLD). Return why it is refused, or ''."""
        if mode is ControlMode.MANUAL:
            return "MANUAL begins with the first command by hand, not with an order"
        if mode is ControlMode.AUTO and self._stop:
            return "the emergency stop is engaged; release it first"
        self._go(mode, who, reason or "ordered")
        return ""

    def see_stop(self, engaged: bool, who: str, reason: str) -> None:
        """Take it that the emergency stop was engaged or released: the robot holds from then on."""
        if engaged:
            self._go(ControlMode.HOLD, who, f"emergency stop: {reason or 'no reason given'}")
        elif self._stop:
            self._go(ControlMode.HOLD, who, "the emergency stop was released")
        self._must_let_go = self._must_let_go or engaged or self._stop
        self._stop = engaged

    def refuses_by_hand(self, who: str, moves: bool) -> str:
        """Return why a command by hand is refused; '' if it is followed. A followed one takes control.

        Args:
            who: who has sent it.
            moves: whether it moves the robot.
        """
        silent_s, self._by_hand_s = self._clock() - self._by_hand_s, self._clock()
        if self._must_let_go and not self._stop and (not moves or silent_s >= self._let_go_s):
            self._must_let_go = False
        if not moves:
            if self.mode is ControlMode.AUTO:
                self._go(ControlMode.MANUAL, who, "an operator has taken over")
            return ""
        if self._stop:
            return "the emergency stop is engaged"
        if self._must_let_go:
            return "the control was held since before the emergency stop was released; let go first"
        if self.mode is not ControlMode.MANUAL or self.who != who:
            self._go(ControlMode.MANUAL, who, "an operator drives")
        return ""

    def refuses_module(self) -> str:
        """Return why a module's command is refused; '' if it is followed."""
        return "" if self.mode is ControlMode.AUTO else f"{self.mode.name}: {self.reason}"

    def look_after(self) -> None:
        """Hold the robot if its operator has let go. Call it several times a second."""
        if self.mode is ControlMode.MANUAL and self._clock() - self._by_hand_s >= self._let_go_s:
            self._go(ControlMode.HOLD, self.who, "the operator has let go")

    def _go(self, mode: ControlMode, who: str, reason: str) -> None:
        self.mode, self.who, self.reason = mode, who, reason
