"""Who controls the robot's motion: modules, an operator, or nobody until somebody orders it to go on.

A robot that was stopped, taken over, or left by its operator stands until it gets an order. Releasing the
emergency stop is no such order (ISO 13850, 4.1.4: the reset shall not restart the machine), and neither is a
stick that was held all the time.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any

SEEN_S = 0.5
"""Somebody who has ordered to go on this soon after an order to hold cannot have seen that order."""
MAX_REASON = 200
"""Length of a reason; a longer one is cut off, so that it fits into what survives a restart."""
MAX_SENDERS = 64
"""Senders of commands by hand that are remembered; of more, the newest."""


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
        let_go_s: an operator has let go when no command by hand was sent for this time.
        before: what the last process knew, from `memory`.

    Attributes:
        mode: how the robot is controlled.
        who: who caused the last change; '' at the start.
        reason: why it changed.
        driver: the module that is followed in AUTO; '' if none has moved the robot yet.
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
        self._moved_s: dict[str, float] = {}
        """When each sender has last sent motion by hand; without those who have said that they let go."""
        self._must_let_go: set[str] = set()
        """Senders whose control was held since before the robot was stopped."""
        self._held_s = -math.inf
        """When somebody has last ordered to hold."""
        self._stop = False
        self.driver, self._driven_s = "", -math.inf
        self.mode, self.who, self.reason = mode, "", "the run has started"
        if before is not None:
            self._remember(before)

    def memory(self) -> dict[str, Any]:
        """Return what the next process must know."""
        return {
            "mode": int(self.mode),
            "who": self.who,
            "reason": self.reason,
            "stop": self._stop,
            "must_let_go": sorted(self._must_let_go),
            "driver": self.driver,
            "held_s": self._held_s,
        }

    def _remember(self, before: dict[str, Any]) -> None:
        """Go on from `memory`; but an operator who drove must take hold of the control again.

        The module that drove keeps control for the let-go time.
        """
        self.mode = ControlMode(before["mode"])
        self.who, self.reason, self._stop = before["who"], before["reason"], before["stop"]
        self._held_s = min(before["held_s"], self._clock())
        self._moved_s = dict.fromkeys(before["must_let_go"], self._clock())
        if before["driver"]:
            self.driver, self._driven_s = before["driver"], self._clock()
        if self.mode is ControlMode.MANUAL:
            self._moved_s[self.who] = self._clock()
            self._go(ControlMode.HOLD, self.who, "the base was restarted while an operator drove")
        self._end_holds()

    def order(self, mode: ControlMode, who: str, reason: str, sent_s: float) -> str:
        """Carry out an order to go on (AUTO) or to stand (HOLD). Return why it is refused, or ''.

        Args:
            mode: what is ordered.
            who: the sender.
            reason: why.
            sent_s: when it was sent, by the clock.
        """
        if mode is ControlMode.MANUAL:
            return "MANUAL begins with the first command by hand, not with an order"
        if mode is ControlMode.AUTO and self._stop:
            return "the emergency stop is engaged; release it first"
        if mode is ControlMode.HOLD:
            self._held_s = self._clock()
            self._end_holds()
        elif sent_s - self._held_s < SEEN_S:
            return f"{self.who} has just ordered to hold ({self.reason}); look, and order again"
        self._go(mode, who, reason or "ordered")
        return ""

    def see_stop(self, engaged: bool, who: str, reason: str) -> None:
        """Take it that the emergency stop was engaged or released: the robot holds from then on."""
        if engaged:
            self._go(ControlMode.HOLD, who, f"emergency stop: {reason or 'no reason given'}")
        elif self._stop:
            self._go(ControlMode.HOLD, who, "the emergency stop was released")
        if engaged or self._stop:
            self._end_holds()
        self._stop = engaged

    def refuses_by_hand(self, who: str, moves: bool, sent_s: float) -> str:
        """Return why a command by hand is refused; '' if it is followed. A followed one takes control.

        Args:
            who: the sender.
            moves: whether it moves the robot.
            sent_s: when it was sent, by the clock. Commands that have waited, because this process was
                stopped, do not look like an operator who had let go.
        """
        sent_s = min(sent_s, self._clock())
        self._by_hand_s = max(self._by_hand_s, sent_s)
        self._note(who, moves, sent_s)
        if not moves:
            if self.mode is ControlMode.AUTO:
                self._go(ControlMode.MANUAL, who, "an operator has taken over")
            return ""
        if self._stop:
            self._must_let_go.add(who)
            return "the emergency stop is engaged"
        if who in self._must_let_go:
            return "the control was held since before the robot was stopped or taken over; let go first"
        if self.mode is not ControlMode.MANUAL or self.who != who:
            self._end_holds(but=who)
            self._go(ControlMode.MANUAL, who, "an operator drives")
        return ""

    def refuses_module(self, who: str, moves: bool, sent_s: float) -> str:
        """Return why a module's command is refused; '' if it is followed.

        The module that moves the robot keeps control until it has sent nothing for the let-go time. Every
        module may let the robot stand.

        Args:
            who: the sender.
            moves: whether it moves the robot.
            sent_s: when it was sent, by the clock.
        """
        if self.mode is not ControlMode.AUTO:
            return f"{self.mode.name}: {self.reason}"
        sent_s = min(sent_s, self._clock())
        if moves and who != self.driver:
            if sent_s - self._driven_s < self._let_go_s:
                return f"{self.driver} drives, until it has sent nothing for {self._let_go_s:g} s"
            self.driver = who
        if who == self.driver:
            self._driven_s = max(self._driven_s, sent_s)
        return ""

    def look_after(self) -> None:
        """Hold the robot if its operator has let go. Call it several times a second."""
        if self.mode is ControlMode.MANUAL and self._clock() - self._by_hand_s >= self._let_go_s:
            self._end_holds()
            self._go(ControlMode.HOLD, self.who, "the operator has let go")

    def _note(self, who: str, moves: bool, sent_s: float) -> None:
        """Note whether a sender holds its control."""
        silent_s = sent_s - self._moved_s.pop(who, -math.inf)
        if not moves or silent_s >= self._let_go_s:
            self._must_let_go.discard(who)
        if moves:
            self._moved_s[who] = sent_s
        if len(self._moved_s) > MAX_SENDERS:
            oldest = next(iter(self._moved_s))
            del self._moved_s[oldest]
            self._must_let_go.discard(oldest)

    def _end_holds(self, but: str | None = None) -> None:
        """Let nobody, but one, move the robot by a control that is held now: it must be let go first."""
        self._must_let_go |= self._moved_s.keys() - {but}

    def _go(self, mode: ControlMode, who: str, reason: str) -> None:
        self.mode, self.who, self.reason = mode, who, reason[:MAX_REASON]
        if mode is not ControlMode.AUTO:
            self.driver, self._driven_s = "", -math.inf
