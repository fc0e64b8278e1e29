"""Where persons may be, and whether the camera has confirmed it.

Legs of furniture look like a person's, and somebody who has stood at a place for long may be on the map. So
all that looks like legs is a candidate, and the camera decides: it finds a face there, or it does not in
several pictures that should show one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from typing import Any, NamedTuple

from robbie_robots.workers.home.follow import PersonReport

MAX_PLACES = 200


class SeenFace(NamedTuple):
    """A face in a picture.

    Attributes:
        name: whose face it is; '' if the robot does not know the person.
        bearing_rad: its direction from the camera, map frame.
        key: what finds the face in its picture again.
        away_m: how far it is from the camera, by its size in the picture. NaN: not known.
    """

    name: str
    bearing_rad: float
    key: Any = None
    away_m: float = math.nan


class Eye(NamedTuple):
    """The camera when it took a picture.

    Attributes:
        x_m: map frame.
        y_m: map frame.
        bearing_rad: the direction in which it looked, map frame.
        half_width_rad: half of its horizontal field of view.
    """

    x_m: float
    y_m: float
    bearing_rad: float
    half_width_rad: float

    def aside_rad(self, xy_m: Sequence[float]) -> float:
        """Return how far beside the picture's middle a place is, to the left."""
        bearing = math.atan2(xy_m[1] - self.y_m, xy_m[0] - self.x_m)
        return math.remainder(bearing - self.bearing_rad, math.tau)


@dataclass(frozen=True)
class PlaceSettings:
    """When a place is a person's.

    Attributes:
        apart_m: legs this near to a place that is known are the same.
        jump_m: a track that is suddenly farther away than this has another person, or another thing.
        fresh_s: a person counts as seen if a leg was seen within this time.
        face_m: the camera finds every face between these distances ...
        far_m: ... and none beyond this one.
        edge_rad: a face this near to the picture's edge may be cut off.
        aside_rad: a face belongs to a place if its direction differs by at most this.
        size_differs: by its size, a face may be this many times as near or as far as its place. So from
            1.1 m, the face of somebody 0.9 m behind a place is not taken for one at that place.
        pictures: what shows no face in this number of pictures is a thing, if it has not walked.
    """

    apart_m: float = 0.35
    jump_m: float = 2.0
    fresh_s: float = 0.4
    face_m: tuple[float, float] = (0.8, 1.9)
    far_m: float = 3.5
    edge_rad: float = 0.12
    aside_rad: float = 0.15
    size_differs: float = 1.4
    pictures: int = 9


@dataclass
class PersonPlace:
    """A place where a person may be.

    Attributes:
        xy_m: m, map frame.
        track: the newest track of the legs; '' if it has left them.
        has_moved: whether the legs have walked.
        confidence: 0 to 1, how likely the legs were legs, at best.
        is_seen: whether the legs are seen now.
        faces: number of pictures with a face there.
        without_face: number of pictures that should show a face, and do not.
        looks: how often the robot was there and saw no face.
        is_open: whether the robot still has to look at it.
    """

    xy_m: tuple[float, float]
    track: str
    has_moved: bool = False
    confidence: float = 0.0
    is_seen: bool = True
    faces: int = 0
    without_face: int = 0
    looks: int = 0
    is_open: bool = True


class PersonPlaces:
    """Keeps places where persons may be, at most `MAX_PLACES`; more are dropped and counted.

    Args:
        settings: when a place is a person's.

    Attributes:
        dropped: number of places that were not kept.
    """

    def __init__(self, settings: PlaceSettings | None = None) -> None:
        self.settings = settings or PlaceSettings()
        self.dropped = 0
        self._places: list[PersonPlace] = []

    @property
    def open(self) -> list[PersonPlace]:
        """Return the places at which the robot has to look."""
        return [place for place in self._places if place.is_open]

    def see(self, persons: Iterable[PersonReport]) -> None:
        """Take all legs that are tracked now."""
        for place in self._places:
            place.is_seen = False
        for one in persons:
            if one.unseen_s <= self.settings.fresh_s:
                self._see(one)

    def _see(self, one: PersonReport) -> None:
        place = self.at(one.name)
        if place is not None and math.dist(place.xy_m, one.xy_m) > self.settings.jump_m:
            place.track, place = "", None
        place = place or self._near(one.xy_m)
        if place is None:
            if len(self._places) >= MAX_PLACES:
                self.dropped += 1
                return
            place = PersonPlace(one.xy_m, one.name)
            self._places.append(place)
        if one.has_moved and not place.has_moved and not place.faces:
            place.is_open = True
        place.xy_m, place.track, place.is_seen = one.xy_m, one.name, True
        place.confidence = max(place.confidence, one.confidence)
        place.has_moved = place.has_moved or one.has_moved

    def _near(self, xy_m: Sequence[float]) -> PersonPlace | None:
        nearest = min(self._places, key=lambda place: math.dist(place.xy_m, xy_m), default=None)
        is_same = nearest is not None and math.dist(nearest.xy_m, xy_m) <= self.settings.apart_m
        return nearest if is_same else None

    def see_faces(
        self, faces: Sequence[SeenFace], eye: Eye, looked_at: PersonPlace | None = None
    ) -> list[tuple[PersonPlace, SeenFace]]:
        """Take the faces of a picture.

        Args:
            faces: all of them.
            eye: the camera at the picture's time.
            looked_at: a face belongs to this place rather than to another one in the same direction.

        Returns:
            The faces that belong to a place, with the place.
        """
        settings, left, nearer = self.settings, list(faces), list[float]()
        found = []
        for place in sorted(
            self._places, key=lambda one: (one is not looked_at, math.dist(one.xy_m, eye[:2]))
        ):
            away_m, aside = math.dist(place.xy_m, eye[:2]), eye.aside_rad(place.xy_m)
            beside = [
                (abs(math.remainder(face.bearing_rad - eye.bearing_rad - aside, math.tau)), number)
                for number, face in enumerate(left)
                if not self._is_elsewhere(face, away_m)
            ]
            is_there = place.is_seen or place is looked_at
            if is_there and beside and min(beside)[0] <= settings.aside_rad and away_m <= settings.far_m:
                place.faces += 1
                found.append((place, left.pop(min(beside)[1])))
            elif self._should_show(place, away_m, aside, eye, nearer):
                place.without_face += 1
                if place.without_face >= settings.pictures and not place.faces and not place.has_moved:
                    place.is_open = False
            if place.is_seen:
                nearer.append(aside)
        return found

    def _is_elsewhere(self, face: SeenFace, away_m: float) -> bool:
        """Return whether a face is much smaller or larger than it would be at this distance."""
        differs = self.settings.size_differs
        # NaN is neither more nor less: a face of unknown size may be at any distance.
        return face.away_m > differs * away_m or differs * face.away_m < away_m

    def _should_show(
        self, place: PersonPlace, away_m: float, aside: float, eye: Eye, nearer: Sequence[float]
    ) -> bool:
        """Return whether a picture should show the face of somebody who is there."""
        low_m, high_m = self.settings.face_m
        is_inside = abs(aside) <= eye.half_width_rad - self.settings.edge_rad
        is_hidden = any(abs(aside - other) < self.settings.aside_rad for other in nearer)
        return place.is_seen and low_m <= away_m <= high_m and is_inside and not is_hidden

    def at(self, track: str) -> PersonPlace | None:
        """Return the place of a track."""
        return next((place for place in self._places if place.track == track), None)

    def memory(self) -> list[list[Any]]:
        """Return all places as plain data, for a restart."""
        return [list(astuple(place)) for place in self._places]

    def remember(self, memory: Iterable[Sequence[Any]]) -> None:
        """Continue with the places that `memory` returned."""
        self._places = [PersonPlace((xy[0], xy[1]), *rest) for xy, *rest in memory]
