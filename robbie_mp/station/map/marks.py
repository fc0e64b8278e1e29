"""The marks on the map and in the 3-D view: points of interest, marks of panels, and marked cells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import Point, PointOfInterest, PointsOfInterest, TimeJump
from robbie_mp.station.watch.latest import MessageSource

MAX_TOPICS = 16
MAX_PLACES = 200
MAX_CELLS = 20_000
"""Maximum number of cells of one layer. Of more, every second, third … is drawn."""


class MarkPicture(NamedTuple):
    """A picture that hangs above a mark in the 3-D view."""

    address: str
    """Where the page finds it; a newer picture has another address."""
    facing_rad: float
    """Direction in which it faces, map frame."""
    height_to_width: float


class MapMark(NamedTuple):
    """A named place or person: a disc or a figure on the map, a ball in the 3-D view."""

    name: str
    colour: str
    """Colour in CSS notation, such as #00897b."""
    x: float
    """Position in the map frame, m; so are y and z."""
    y: float
    z: float
    picture: MarkPicture | None = None
    shape: str = "disc"
    """On the map: "disc" for a place, "person" for a human being."""


class CellMarks(NamedTuple):
    """Cells of the map that a layer marks."""

    revision: int
    """A number that changes when the cells do."""
    middles: NDArray[np.float64]
    """(N, 2), m, map frame."""
    edge_m: float = 0.0
    """Edge of a cell, as large as it is drawn; 0: a dot."""

    def thinned(self) -> NDArray[np.float64]:
        """Return at most `MAX_CELLS` of the middles, with a height of 0: (N, 3), m."""
        every = -(-len(self.middles) // MAX_CELLS) or 1
        return np.pad(self.middles[::every], ((0, 0), (0, 1)))


class CellLayer(NamedTuple):
    """A layer of the map with cells in one colour."""

    title: str
    colour: str
    """In CSS notation, such as #00897b."""
    source: Callable[[], CellMarks]
    is_hidden: bool = False
    """Whether it is hidden until a visitor shows it; until then, no page gets its cells."""


class MapMarks:
    """Collects the marks of all panels.

    Attributes:
        layers: the layers with cells.
        area_warnings: return what is wrong with a no-go area that has these corners; '' if nothing is. They
            run in threads beside the page server.
    """

    def __init__(self) -> None:
        self.area_warnings: list[Callable[[Sequence[Point]], str]] = []
        self.layers: list[CellLayer] = []
        self._sources: dict[str, Callable[[], Iterable[MapMark]]] = {}

    def add(self, title: str, source: Callable[[], Iterable[MapMark]]) -> None:
        """Add a source of marks. Constructors of panels call this.

        Args:
            title: a name for the marks, in the plural; a page shows their number.
            source: returns the present marks; called in the module's thread and in the page server's.
        """
        self._sources[title] = source

    def add_cells(
        self, title: str, colour: str, source: Callable[[], CellMarks], *, is_hidden: bool = False
    ) -> None:
        """Add a layer of cells, which visitors can hide. Constructors of panels call this.

        Args:
            title: the layer's name.
            colour: its colour in CSS notation.
            source: returns the present cells; called in the module's thread.
            is_hidden: whether the layer is hidden until a visitor shows it.
        """
        self.layers.append(CellLayer(title, colour, source, is_hidden))

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
