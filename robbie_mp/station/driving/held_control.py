"""The rules for controls that move the robot while they are held: whose commands count, and which."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import Duration
from robbie_mp.station.dead_man import DeadManSwitch

if TYPE_CHECKING:
    from robbie_mp.station.context import Page, StationContext

VALID_FOR = Duration.from_nanoseconds(170_000_000)
"""A device stops when no further command arrives for this time. Pages send one every 50 ms; two may fail."""


class HeldControl:
    """Decides whether a command that a page has sent may move the robot.

    Args:
        station: holds the driving page, and the operator who holds the command of the robot.
        page: the page, whose role is checked.
        what: a name for the action in texts, such as "driving".

    Attributes:
        refused: number of commands refused here because an operator elsewhere drives.
    """

    def __init__(self, station: StationContext, page: Page, what: str):
        self._station = station
        self._page = page
        self._what = what
        self._switch = DeadManSwitch()
        self.refused = 0

    @property
    def stale(self) -> int:
        """Number of commands that came too late."""
        return self._switch.stale

    @property
    def is_other_driving(self) -> bool:
        """Whether another page, or an operator elsewhere, drives."""
        is_other_page = self._station.drivers_seat.holder not in (None, self._page.key)
        return is_other_page or bool(self._station.robot_command.other)

    def accepts(self, *, held: bool, begins: bool, sent_s: float) -> bool:
        """Return whether a command counts: the visitor may, nobody else drives, and the command is fresh.

        Args:
            held: whether the control is held. The command that ends a drive counts even if it is late.
            begins: whether the operator has just taken hold of the control.
            sent_s: when the page sent the command, on the page's monotonic clock.
        """
        if not self._page.may(self._what) or not self._station.drivers_seat.take(self._page.key):
            return False
        if begins:
            self._switch.begin()
            self._begin()
        if not self._switch.accept(sent_s, time.monotonic()) and held:
            return False
        robot = self._station.robot_command
        if robot.is_here and robot.other:
            self.refused += 1
            return False
        return True

    def _begin(self) -> None:
        """Ask the robot for the command, or tell that an operator elsewhere holds it."""
        robot = self._station.robot_command
        robot.take()
        if robot.other:
            text = f"{robot.text}: your commands are refused. Take over to drive"
            ui.notify(text, type="warning")
