"""Recognise by its appearance a place that the robot has seen before, wherever the map says that it is.

A place is what the sweeps around it show. It is described by which sectors of which rings around it have
surfaces: Kim and Kim, "Scan context: egocentric spatial descriptor for place recognition within 3D point
cloud map" (IROS 2018), here in the plane. The share of each ring, which no turn changes, tells the
candidates; the shift of the sectors that fits best tells the turn.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.mapping.key_sweeps import KeySweeps

EVERY_M = 2.0  # of travel from one described place to the next
AROUND_M = 5.0  # travel before and after it, whose sweeps show a place
MOST_SWEEPS = 20
RINGS, RING_M, SECTORS = 12, 1.0, 60
MOST_ALIKE = 12  # places with the most similar rings, whose sectors are compared
LEAST_LIKENESS = 0.35  # cosine


class PlaceIndex:
    """The described places of a map.

    Args:
        keys: The map's sweeps.
    """

    def __init__(self, keys: KeySweeps) -> None:
        self._keys = keys
        self._numbers = np.zeros(0, np.int64)
        self._described = np.zeros((0, RINGS, SECTORS), np.bool_)
        self._described_m = 0.0

    def state(self) -> dict[str, Any]:
        """Return the described places."""
        return {
            "numbers": self._numbers.copy(),
            "described": np.packbits(self._described),
            "described_m": self._described_m,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self._numbers = np.array(state["numbers"])
        shape = (len(self._numbers), RINGS, SECTORS)
        bits = np.unpackbits(state["described"], count=int(np.prod(shape)))
        self._described = bits.reshape(shape).astype(np.bool_)
        self._described_m = float(state["described_m"])

    def renumber(self, new_numbers: NDArray[np.int64]) -> None:
        """Take the new number of each old key sweep `(N,)`: its own, or its heir's.

        Of places with the same heir, the newest stays, so there are never more places than key sweeps.
        """
        numbers = new_numbers[self._numbers]
        kept = len(numbers) - 1 - np.unique(numbers[::-1], return_index=True)[1]
        kept.sort()
        self._numbers, self._described = numbers[kept], self._described[kept]

    def look(self) -> int | None:
        """Describe the next place, once the robot has left it behind. Return its key sweep."""
        travelled = self._keys.travelled_m
        behind_m = float(travelled[-1]) - AROUND_M
        if behind_m - self._described_m < EVERY_M:
            return None
        self._described_m = behind_m
        number = int(np.searchsorted(travelled, behind_m))
        self._numbers = np.append(self._numbers, number)
        self._described = np.append(self._described, self._describe(number)[None], axis=0)
        return number

    def _describe(self, number: int) -> NDArray[np.bool_]:
        travelled = self._keys.travelled_m
        near = np.flatnonzero(np.abs(travelled - travelled[number]) < AROUND_M)
        every = self._keys.spaced(near[:: max(1, len(near) // MOST_SWEEPS)], MOST_SWEEPS)
        points = self._keys.surfaces(every).seen_from(self._keys.poses[number]).points
        rings = (np.hypot(*points.T) / RING_M).astype(np.int64)
        sectors = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS
        place = np.zeros((RINGS, SECTORS), np.bool_)
        place[rings[rings < RINGS], sectors[rings < RINGS]] = True
        return place

    def alike(self, possible: NDArray[np.bool_], most: int) -> list[tuple[int, float]]:
        """Return the places that look like the newest one.

        Args:
            possible: Which key sweeps `(N,)` count.
            most: Greatest number of places.

        Returns:
            The key sweep of each, and how far the newest place is turned from it (rad); the most alike first.
        """
        others = np.flatnonzero(possible[self._numbers[:-1]])
        if not len(others):
            return []
        newest = self._described[-1]
        apart = np.abs(self._described[others].mean(axis=2) - newest.mean(axis=1)).sum(axis=1)
        others = others[np.argsort(apart, kind="stable")[:MOST_ALIKE]]
        shapes = self._described[others].astype(float)
        spectra = np.fft.rfft(shapes, axis=2) * np.conj(np.fft.rfft(newest.astype(float), axis=1))
        common = np.fft.irfft(spectra, SECTORS, axis=2).sum(axis=1)  # by shift of the sectors
        likeness = common / np.sqrt(np.maximum(shapes.sum(axis=(1, 2)) * newest.sum(), 1.0))[:, None]
        shift = likeness.argmax(axis=1)
        best = likeness.max(axis=1)
        order = [one for one in np.argsort(-best, kind="stable") if best[one] >= LEAST_LIKENESS]
        return [
            (int(self._numbers[others[one]]), float(shift[one] * 2 * np.pi / SECTORS)) for one in order[:most]
        ]
