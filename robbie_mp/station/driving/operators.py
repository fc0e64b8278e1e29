"""The open pages, and which of them, or which operator elsewhere, drives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robbie_mp.station.driving.seat import DriversSeat

if TYPE_CHECKING:
    from robbie_mp.station.driving.command import RobotCommand
    from robbie_mp.station.page.page import Page


class Operators:
    """Knows who could drive, and who does.

    Args:
        command: which operator has control of the robot, here or elsewhere.

    Attributes:
        pages: the open pages, by their keys.
        seat: the page that drives.
    """

    def __init__(self, command: RobotCommand):
        self.command = command
        self.pages: dict[str, Page] = {}
        self.seat = DriversSeat()

    def opened(self, page: Page) -> None:
        """Add an open page; called in the page server's thread."""
        self.pages[page.key] = page

    def closed(self, page: Page) -> None:
        """Remove a page, which then no longer drives; called in the page server's thread."""
        self.pages.pop(page.key, None)
        if self.seat.holder == page.key:
            self.seat.leave(page.key)
            self.command.give_up()
