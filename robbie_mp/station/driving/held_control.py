"""The rules for controls that move the robot while they are held: whose commands count, and which."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import Duration
from robbie_mp.station.driving.dead_man import LIMIT_S

if TYPE_CHECKING:
    from robbie_mp.station.driving.operators import Operators
    from robbie_mp.station.page.page import Page

VALID_FOR = Duration.from_nanoseconds(170_000_000)
"""A device stops when no further command arrives for this time. Pages send one every 50 ms; two may fail."""


class HeldControl:
    """Decides whether a command that a page has sent may move the robot.

    Args:
        operators: the page that drives, and the operator who has control of the robot.
        page: the page, whose role is checked.
        what: a name for the action in texts, such as "driving".

    Attributes:
        refused: number of commands refused here because an operator elsewhere drives.
        stale: number of commands that came too late, or when the page had lost control.
    """

    def __init__(self, operators: Operators, page: Page, what: str):
        self._operators = operators
        self._page = page
        self._what = what
        self._drive: int | None = None
        self.refused = self.stale = 0

    @property
    def is_other_driving(self) -> bool:
        """Whether another page, or an operator elsewhere, drives."""
        is_other_page = self._operators.seat.holder not in (None, self._page.key)
        return is_other_page or bool(self._operators.command.other)

    def age_s(self, *, held: bool, begins: bool, sent_s: float) -> float | None:
        """Return the greatest age of a command that counts, in s; None if it does not count.

        It counts if the visitor may, nobody else drives, and it is fresh. A page whose network was too slow
        has lost control until the operator takes hold again. Letting go counts however late it comes.

        Args:
            held: whether the control is held; False: the operator has let go.
            begins: whether the operator has just taken hold of the control.
            sent_s: when the page sent the command, on the page's monotonic clock.
        """
        if not self._page.may(self._what):
            return None
        age_s = self._page.dead_man.age_s(sent_s, time.monotonic())
        if not held:
            is_counted = self._operators.seat.holder in (None, self._page.key)
        else:
            is_counted = self._may_move(begins=begins, age_s=age_s)
        return age_s if is_counted and not self._is_refused() else None

    def _may_move(self, *, begins: bool, age_s: float) -> bool:
        """Return whether the page is in control and the command is fresh."""
        switch = self._page.dead_man
        if begins:
            self._drive = switch.losses
        if not switch.is_too_slow and not self._takes_seat():
            self._drive = None  # control that comes free is not for a page that still holds on
            return False
        if begins:
            self._begin()
        if switch.is_too_slow or self._drive != switch.losses or age_s > LIMIT_S:
            self.stale += 1
            return False
        return True

    def _takes_seat(self) -> bool:
        """Return whether the page has the seat; a drive during which another page had it does not get it."""
        return self._drive is not None and self._operators.seat.take(self._page.key)

    def _is_refused(self) -> bool:
        """Count a command that the link of this robot refuses, and return whether it does."""
        robot = self._operators.command
        is_refused = robot.is_here and bool(robot.other)
        self.refused += is_refused
        return is_refused

    def _begin(self) -> None:
        """Ask the robot for the command, or tell that an operator elsewhere holds it."""
        robot = self._operators.command
        robot.take()
        if robot.other:
            text = f"{robot.text}: your commands are refused. Take over to drive"
            ui.notify(text, type="warning")
