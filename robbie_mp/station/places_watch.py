"""Points of interest, as all modules have told of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robbie_mp.messages import PointOfInterest, PointsOfInterest, TimeJump

if TYPE_CHECKING:
    from robbie_mp.station.station import OperatorStation

MOST_TOPICS = 16
MOST_PLACES = 200


class PlacesWatch:
    """Keeps the newest list of each topic.

    Attributes:
        places: those of all lists; replaced and never changed, for other threads look at it.
    """

    def __init__(self, station: OperatorStation):
        self.places: tuple[PointOfInterest, ...] = ()
        self._station = station
        self._lists: dict[str, list[PointOfInterest]] = {}
        station.hear(PointsOfInterest, self._on_places)
        station.hear(TimeJump, lambda _jump: self._keep({}))

    def _on_places(self, message: PointsOfInterest) -> None:
        topic = self._station.envelope.topic
        if topic in self._lists or len(self._lists) < MOST_TOPICS:
            # A copy: kept messages would fill their publisher's memory.
            self._keep({**self._lists, topic: PointsOfInterest.decode(message.encode()).points})

    def _keep(self, lists: dict[str, list[PointOfInterest]]) -> None:
        self._lists = lists
        self.places = tuple(place for points in lists.values() for place in points)[:MOST_PLACES]
