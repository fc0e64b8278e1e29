"""The base class of panels. A panel subscribes once, and is built for each page that is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.log_events import EventKind
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.page.state_item import StateItem


def columns(*names: str) -> list[dict[str, Any]]:
    """Describe the columns of a table whose rows have these names as keys."""
    return [{"name": name, "label": name, "field": name, "align": "left", "sortable": True} for name in names]


class Panel(ABC):
    """One tile of the page.

    Args:
        station: what there is. Take what the panel uses in its constructor, and subscribe there, usually with
            `station.messages.newest`. Publish with `Page.publish`, in any thread.
    """

    name: ClassVar[str]
    """The name that profiles use in `tabs`."""
    title: ClassVar[str]
    icon: ClassVar[str]
    """Name of a Material Icon of NiceGUI."""
    log_events: ClassVar[Sequence[EventKind]] = ()
    """Kinds of events in a log that the playback's bar shows, besides crashes and marks."""
    is_built_when_shown: ClassVar[bool] = False
    """Whether a page calls `build` only when it shows the panel for the first time, so that it opens sooner.
    Such a panel can add no keys there."""

    def __init__(self, station: StationContext):
        self._pages = station.operators.pages

    @classmethod
    def is_wanted(cls, _station: StationContext) -> bool:
        """Return whether the panel has anything to show. Used only if the profile names no tabs."""
        return True

    @property
    def is_looked_at(self) -> bool:
        """Whether any page shows the panel. Otherwise it need not prepare anything."""
        return any(self.name in page.shown for page in tuple(self._pages.values()))

    def state_items(self) -> Iterable[StateItem]:
        """Return what the strip at the top shows in every layout. Runs in the module's thread."""
        return ()

    def tick(self) -> None:  # noqa: B027 - most panels have nothing to do
        """Do the work that is common to all pages. Runs in the module's thread at each tick."""

    def close(self) -> None:  # noqa: B027
        """Release the panel's resources."""

    def build_on_every_tab(self, page: Page) -> None:  # noqa: B027 - most panels have nothing to show there
        """Build elements above the tiles, which are visible in every layout."""

    def build_below_tiles(self, page: Page) -> None:  # noqa: B027
        """Build elements below the tiles, which are visible in every layout and make room for themselves."""

    @abstractmethod
    def build(self, page: Page) -> None:
        """Build the panel's elements for a page. Runs in the page server's thread, and must not block."""
