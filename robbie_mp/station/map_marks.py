"""The marks on the map and in the 3-D view: points of interest, and marks of panels."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from robbie_mp.messages import PointOfInterest, PointsOfInterest, TimeJump
from robbie_mp.station.latest import MessageSource

MAX_TOPICS = 16
MAX_PLACES = 200


class MapMark(NamedTuple):
    """A named place: a disc on the map, a ball in the 3-D view."""

    name: str
    colour: str
    """Colour in CSS notation, such as #00897b."""
    x: float
    """Position in the map frame, m; so are y and z."""
    y: float
    z: float


class MapMarks:
    """Collects the marks of all panels."""

    def __init__(self) -> None:
        self._sources: dict[str, Callable[[], Iterable[MapMark]]] = {}

    def add(self, title: str, source: Callable[[], Iterable[MapMark]]) -> None:
        """Add a source of marks. Constructors of panels call this.

        Args:
            title: a name for the marks, in the plural; a page shows their number.
            source: returns the present marks; called in the module's thread and in the page server's.
        """
        self._sources[title] = source

    def now(self) -> dict[str, tuple[MapMark, ...]]:
        """Return the present marks, by the titles of their sources."""
        return {title: tuple(source()) for title, source in self._sources.items()}


class PlacesWatch:
    """Keeps the newest list of points of interest on each topic.

    Attributes:
        places: the points of all lists. The tuple is replaced and never changed, because other threads read
            it.
    """

    def __init__(self, source: MessageSource):
        self.places: tuple[PointOfInterest, ...] = ()
        self._source = source
        self._lists: dict[str, list[PointOfInterest]] = {}
        source.hear(PointsOfInterest, self._on_places)
        source.hear(TimeJump, lambda _jump: self._keep({}))

    def _on_places(self, message: PointsOfInterest) -> None:
        topic = self._source.envelope.topic
        if topic in self._lists or len(self._lists) < MAX_TOPICS:
            # A copy: kept messages would fill their publisher's memory.
            self._keep({**self._lists, topic: PointsOfInterest.decode(message.encode()).points})

    def _keep(self, lists: dict[str, list[PointOfInterest]]) -> None:
        self._lists = lists
        self.places = tuple(place for points in lists.values() for place in points)[:MAX_PLACES]
