"""Names what stands on a table: by what is printed on it, if that was taught, and otherwise by its size."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.taught import Box, Sighting

Floats = NDArray[np.float64]

MIN_OVERLAP = 0.25
"""A sighting belongs to an object if their rectangles have at least this share of both in common."""
MIN_AHEAD_M = 0.05


@dataclass(frozen=True)
class Prints:
    """What a recognizer has seen in a colour picture.

    Attributes:
        sightings: what it has seen.
        taught: all names that it knows.
        X_CB: the base's pose in the frame of the camera (z ahead, x right, y down), (4, 4).
        focal_px: the camera's focal length.
        centre_px: its principal point.
    """

    sightings: tuple[Sighting, ...]
    taught: frozenset[str]
    X_CB: Floats
    focal_px: float
    centre_px: tuple[float, float]

    def place(self, points: Floats) -> Box:
        """Return the rectangle around points (N, 3), m, base's frame, in the picture."""
        seen = points @ self.X_CB[:3, :3].T + self.X_CB[:3, 3]
        seen = seen[seen[:, 2] > MIN_AHEAD_M]
        if not len(seen):
            return Box(0.0, 0.0, 0.0, 0.0)
        pixels = seen[:, :2] / seen[:, 2:] * self.focal_px + self.centre_px
        (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
        return Box(left, top, right - left, bottom - top)


class ObjectNamer:
    """Gives names, and remembers which size each taught object has.

    Args:
        known: names of the objects whose size is known.
        certain: minimum confidence of a sighting.
    """

    def __init__(self, known: Iterable[str], certain: float = 0.7) -> None:
        self._known, self._certain = frozenset(known), certain
        self._sizes: dict[str, set[str]] = {}
        """For each taught name the names of known objects of its size."""

    def names(
        self, clusters: Sequence[Floats], by_size: Sequence[Sequence[str]], prints: Prints | None
    ) -> list[str]:
        """Return the name of each object; '' if it is not known. No two have the same.

        A name that was taught is given by size only if nothing else can be meant: no other object of this
        size is in view without a name, and no other taught object has this size.

        Args:
            clusters: the points of each object, (N, 3), m, base's frame.
            by_size: names of the known objects of its size, the most like first.
            prints: what was recognized; None: nothing can be.
        """
        names = [""] * len(clusters)
        taught: frozenset[str] = frozenset()
        if prints is not None:
            taught = prints.taught
            self._sizes = {name: sizes for name, sizes in self._sizes.items() if name in taught}
            for name, place in self._joined(clusters, by_size, prints):
                names[place] = name
                self._sizes.setdefault(name, set()).update(by_size[place])
        nameless = [place for place in range(len(names)) if not names[place]]
        for place in nameless:
            possible = by_size[place]
            is_only_one = sum(not {*by_size[other]}.isdisjoint(possible) for other in nameless) == 1
            for name in possible:
                if name in names:
                    continue
                if name not in taught or (is_only_one and not self._others(name, possible, taught, names)):
                    names[place] = name
                    break
        return names

    def memory(self) -> dict[str, list[str]]:
        """Return what the next process needs, as plain data."""
        return {name: sorted(sizes) for name, sizes in self._sizes.items()}

    def remember(self, memory: Mapping[str, Iterable[str]]) -> None:
        """Take over what `memory` returned."""
        self._sizes = {name: set(sizes) for name, sizes in memory.items()}

    def _others(
        self, name: str, possible: Sequence[str], taught: Iterable[str], names: Sequence[str]
    ) -> bool:
        """Return whether another taught object, which is not in view elsewhere, has the same size."""
        return any(
            other in possible or not self._sizes.get(other, set()).isdisjoint(possible)
            for other in taught
            if other != name and other not in names
        )

    def _joined(
        self, clusters: Sequence[Floats], by_size: Sequence[Sequence[str]], prints: Prints
    ) -> list[tuple[str, int]]:
        """Return which sighting is which object, each at most once; those that overlap most come first."""
        places = [prints.place(points) for points in clusters]
        pairs = [
            (overlap(one.box, place), one.confidence, one.name, number)
            for one in prints.sightings
            if one.name and one.confidence >= self._certain
            for number, place in enumerate(places)
            # A sighting that contradicts a known size is wrong.
            if one.name not in self._known or one.name in by_size[number]
        ]
        joined: dict[str, int] = {}
        for share, _, name, number in sorted(pairs, reverse=True):
            if share >= MIN_OVERLAP and name not in joined and number not in joined.values():
                joined[name] = number
        return [*joined.items()]


def overlap(one: Box, other: Box) -> float:
    """Return what two rectangles have in common, as a share of what they cover together."""
    across = min(one.left + one.width, other.left + other.width) - max(one.left, other.left)
    down = min(one.top + one.height, other.top + other.height) - max(one.top, other.top)
    common = max(0.0, across) * max(0.0, down)
    whole = one.width * one.height + other.width * other.height - common
    return common / whole if whole > 0.0 else 0.0
