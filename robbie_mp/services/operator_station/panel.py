"""What every panel of the page is: subscribed once, built for each page that is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, ClassVar, Protocol

from nicegui import ui

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.access import Role
    from robbie_mp.services.operator_station.station import OperatorStation


class Link(Protocol):
    """The connection to a browser."""

    @property
    def is_free(self) -> bool:
        """Whether the browser has taken what it was sent, all but a little."""


class Page:
    """One page that is open in a browser.

    Args:
        key: names it among all that are open.
        role: what its visitor may do.
        link: the connection to it.
    """

    def __init__(self, key: str, role: Role, link: Link):
        self.key = key
        self.role = role
        self.link = link
        self.tab = ""
        """Name of the panel that is looked at."""

    def every(self, period_s: float, panel: str, update: Callable[[], Awaitable[None] | None]) -> None:
        """Have something done while a panel is looked at, and not while it is not.

        An update that can be awaited, as one that waits for the browser, is over before the next one begins.
        """
        self.always(period_s, lambda: update() if self.tab == panel else None)

    def always(self, period_s: float, update: Callable[[], Awaitable[None] | None]) -> None:
        """Have something done on whatever panel; but not while the browser does not keep up with the rest."""
        ui.timer(period_s, lambda: update() if self.link.is_free else None)


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

    @classmethod
    def is_wanted(cls, _station: OperatorStation) -> bool:
        """Whether it has anything to show, where the profile does not say which panels there are."""
        return True

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
