"""The base of all panels: a panel subscribes once, and is built for each page that is opened."""

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
        station: gives the messages. Subscribe in the constructor, as a rule with `station.newest`. Publish
            with `Page.publish`, from any thread.
    """

    name: ClassVar[str]
    """The name with which profiles arrange the tabs."""
    title: ClassVar[str]
    icon: ClassVar[str]
    """A name of the Material Icons that come with NiceGUI."""
    log_events: ClassVar[Sequence[EventKind]] = ()
    """Events that the playback's bar shows of a log, besides crashes and marks."""

    def __init__(self, station: StationContext):
        self.station = station

    @classmethod
    def is_wanted(cls, _station: StationContext) -> bool:
        """Return whether the panel has anything to show; asked if the profile names no tabs."""
        return True

    @property
    def is_looked_at(self) -> bool:
        """Whether any page shows the panel; otherwise it need not prepare anything."""
        return any(page.tab == self.name for page in tuple(self.station.pages.values()))

    def tick(self) -> None:  # noqa: B027 - most panels have nothing to do
        """Do the work that is done once for all pages; runs in the module's thread, at each of its ticks."""

    def close(self) -> None:  # noqa: B027
        """Close what the panel has opened."""

    def build_on_every_tab(self, page: Page) -> None:  # noqa: B027 - most panels have nothing to show there
        """Make the elements that a page shows above the tabs, whichever tab is open."""

    @abstractmethod
    def build(self, page: Page) -> None:
        """Make the panel's elements for a page; runs in the page server's thread, and must not block."""
