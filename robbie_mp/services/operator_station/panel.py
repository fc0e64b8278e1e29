"""What every panel of the page is: subscribed once, built for each page that is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, ClassVar

from nicegui import ui

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.access import Role
    from robbie_mp.services.operator_station.station import OperatorStation


class Page:
    """One page that is open in a browser.

    Args:
        key: names it among all that are open.
        role: what its visitor may do.
    """

    def __init__(self, key: str, role: Role):
        self.key = key
        self.role = role
        self.tab = ""
        """Name of the panel that is looked at."""

    def every(self, period_s: float, panel: str, update: Callable[[], Awaitable[None] | None]) -> None:
        """Have something done while a panel is looked at, and not while it is not.

        An update that can be awaited, as one that waits for the browser, is over before the next one begins.
        """

        def due() -> Awaitable[None] | None:
            return update() if self.tab == panel else None

        ui.timer(period_s, due)


class Panel(ABC):
    """One tab of the page.

    Args:
        station: the module; messages are subscribed to in the constructor, as a rule by `station.newest`, and
            published from any thread.
    """

    name: ClassVar[str]
    """By which the profile arranges it."""
    title: ClassVar[str]
    icon: ClassVar[str]
    """A name of the Material Icons that come with NiceGUI."""

    def __init__(self, station: OperatorStation):
        self.station = station

    @property
    def is_looked_at(self) -> bool:
        """Whether any page shows it; what nobody looks at need not be prepared."""
        return any(page.tab == self.name for page in tuple(self.station.pages.values()))

    def tick(self) -> None:  # noqa: B027 - most panels have nothing to do
        """Do what is done once for all pages; runs in the module's thread, at each of its ticks."""

    def close(self) -> None:  # noqa: B027
        """Let go of what was opened."""

    @abstractmethod
    def build(self, page: Page) -> None:
        """Make the panel's elements for a page; runs in the page server's thread, and must not block."""
