"""What every panel of the page is: subscribed once, built for each page that is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robbie_mp.station.context import Page, StationContext
    from robbie_mp.station.log_events import EventKind


def columns(*names: str) -> list[dict[str, Any]]:
    """Describe the columns of a table whose rows have these names as keys."""
    return [{"name": name, "label": name, "field": name, "align": "left", "sortable": True} for name in names]


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
    log_events: ClassVar[Sequence[EventKind]] = ()
    """Events that the playback's bar shows of a log, besides crashes and marks."""

    def __init__(self, station: StationContext):
        self.station = station

    @classmethod
    def is_wanted(cls, _station: StationContext) -> bool:
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

    def build_on_every_tab(self, page: Page) -> None:  # noqa: B027 - most panels have nothing to show there
        """Make what is in sight above the tabs of a page, whichever panel is looked at."""

    @abstractmethod
    def build(self, page: Page) -> None:
        """Make the panel's elements for a page; runs in the page server's thread, and must not block."""
