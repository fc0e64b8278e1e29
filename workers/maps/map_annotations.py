"""Drawings of people on a map: no-go areas, which the robot must not enter, and named places."""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import Dumper, read_file
from robbie_robots.workers.maps.navigation_grid import FORBIDDEN

MAX_AREAS = 64
MAX_CORNERS = 64  # of one area
MAX_PLACES = 128
MAX_NAME = 64  # characters
MAX_M = 10_000.0  # distance from the map's origin along each axis
MAX_UNDO = 50
SUFFIX = ".annotations.yaml"

Corners = Sequence[tuple[float, float]]
Place = tuple[float, float, float]


class AnnotationError(ValueError):
    """An invalid change of the annotations; the message says what was expected."""


class AnnotationFileError(ValueError):
    """An invalid file with annotations; the message names the file and what was expected."""


class Annotations(NamedTuple):
    """No-go areas and places by their names. The mappings are never changed.

    Attributes:
        no_go: The corners (x, y) of each area, m, map frame.
        places: x, y (m) and heading (rad) of each place, map frame.
    """

    no_go: Mapping[str, Corners] = {}
    places: Mapping[str, Place] = {}

    def changed(
        self,
        remove: Iterable[str] = (),
        no_go: Iterable[tuple[str, Corners]] = (),
        places: Iterable[tuple[str, Place]] = (),
    ) -> "Annotations":
        """Return the annotations after a change.

        Args:
            remove: Names of areas and places that go.
            no_go: Areas that come. One without a name gets the next free one.
            places: Places that come.

        Raises:
            AnnotationError: A name, a number or their count is wrong, or there is nothing to remove.
        """
        areas, spots = dict(self.no_go), dict(self.places)
        for name in remove:
            if areas.pop(name, None) is None and spots.pop(name, None) is None:
                raise AnnotationError(f"no area and no place is called {name!r:.80}")
        for name, corners in no_go:
            called = _checked_name(name or _free_name(areas, spots))
            if called in spots:
                raise AnnotationError(f"a place is called {called!r} already")
            areas[called] = _checked_corners(called, corners)
        for name, place in places:
            if _checked_name(name) in areas:
                raise AnnotationError(f"an area is called {name!r} already")
            spots[name] = _checked_place(name, place)
        for found, limit, what in ((areas, MAX_AREAS, "no-go areas"), (spots, MAX_PLACES, "places")):
            if len(found) > limit:
                raise AnnotationError(f"a map holds at most {limit} {what}")
        return Annotations(areas, spots)


class AnnotatedMap:
    """The annotations of one map, with the changes that can be taken back.

    Args:
        now: The annotations.
        revision: Number of changes so far.
        before: The annotations before each of the last changes, the oldest first.
    """

    def __init__(
        self, now: Annotations | None = None, revision: int = 0, before: Iterable[Annotations] = ()
    ) -> None:
        self.now = now or Annotations()
        self.revision = revision
        self._before = deque(before, maxlen=MAX_UNDO)

    @property
    def can_undo(self) -> bool:
        """Return whether there is a change to take back."""
        return bool(self._before)

    def replaced(self, annotations: Annotations) -> "AnnotatedMap":
        """Return the map with other annotations; the present ones can come back by `undone`."""
        return AnnotatedMap(annotations, self.revision + 1, [*self._before, self.now])

    def undone(self) -> "AnnotatedMap":
        """Return the map without its last change.

        Raises:
            AnnotationError: There is no change to take back.
        """
        if not self._before:
            raise AnnotationError("there is no change to take back")
        *before, last = self._before
        return AnnotatedMap(last, self.revision + 1, before)

    def state(self) -> dict[str, Any]:
        """Return all of it as plain data, for `from_state`."""
        return {
            "now": _plain(self.now),
            "revision": self.revision,
            "before": [_plain(one) for one in self._before],
        }

    @staticmethod
    def from_state(state: Mapping[str, Any]) -> "AnnotatedMap":
        """Return what `state` was made of."""
        before = [_from_plain(one) for one in state["before"]]
        return AnnotatedMap(_from_plain(state["now"]), state["revision"], before)

    def as_yaml(self) -> str:
        """Return the text of the file, which `read_annotations` reads."""
        described = {"revision": self.revision, **_plain(self.now)}
        text: str = yaml.dump(
            described, Dumper=Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None
        )
        return text


def annotations_path(map_file: Path) -> Path:
    """Return the path of a map's annotations: beside its YAML file."""
    return map_file.with_suffix(SUFFIX)


def read_annotations(path: Path) -> AnnotatedMap:
    """Read annotations; a file that does not exist has none.

    Raises:
        AnnotationFileError: The file cannot be read, or is invalid.
    """
    try:
        path.stat()
        described = read_file(path).plain()
    except FileNotFoundError:
        return AnnotatedMap()
    except (ProfileError, OSError) as error:
        raise AnnotationFileError(f"{path}: {error}" if isinstance(error, OSError) else str(error)) from error
    try:
        if not isinstance(described, dict) or set(described) - {"revision", "no_go", "places"}:
            raise AnnotationError("expected the keys revision, no_go and places")
        revision = described.get("revision", 0)
        if type(revision) is not int or not 0 <= revision < 2**32:
            raise AnnotationError(f"revision must be a number of changes, not {revision!r:.80}")
        return AnnotatedMap(_from_plain(described), revision)
    except AnnotationError as error:
        raise AnnotationFileError(f"{path}: {error}") from error


def forbid(
    cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike, areas: Iterable[ArrayLike]
) -> NDArray[np.int8]:
    """Return a map in which the cells of no-go areas are FORBIDDEN, those on their edges included.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown; not changed.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        areas: The corners `(N, 2)` of each area, m, map frame.
    """
    polygons = [np.asarray(area, float) for area in areas]
    if not polygons or not cells.size:
        return cells
    mask = Image.new("L", (cells.shape[1], cells.shape[0]))
    pen = ImageDraw.Draw(mask)
    for polygon in polygons:
        corners = np.floor((polygon - np.asarray(corner_xy_m, float)) / resolution_m).astype(int)
        pen.polygon([(column, row) for column, row in corners.tolist()], fill=1, outline=1)
    forbidden = cells.copy()
    forbidden[np.asarray(mask) > 0] = FORBIDDEN
    return forbidden


def _free_name(areas: Mapping[str, object], places: Mapping[str, object]) -> str:
    taken = {*areas, *places}
    return next(name for number in range(1, len(taken) + 2) if (name := f"no-go {number}") not in taken)


def _checked_name(name: object) -> str:
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > MAX_NAME:
        raise AnnotationError(f"a name has 1 to {MAX_NAME} printable characters, unlike {name!r:.80}")
    return name


def _checked_corners(name: str, corners: Any) -> Corners:
    if not isinstance(corners, list | tuple) or not 3 <= len(corners) <= MAX_CORNERS:
        raise AnnotationError(f"the area {name!r} must have 3 to {MAX_CORNERS} corners")
    checked = [_checked_numbers(name, corner, 2) for corner in corners]
    if len({*checked}) < 3:
        raise AnnotationError(f"the area {name!r} must have 3 different corners")
    return [(corner[0], corner[1]) for corner in checked]


def _checked_place(name: str, place: Any) -> Place:
    x_m, y_m, heading_rad = _checked_numbers(name, place, 3)
    if abs(heading_rad) > math.tau:
        raise AnnotationError(f"{name!r}: a heading is at most 2 pi, not {heading_rad:g}; is it in degrees?")
    return x_m, y_m, heading_rad


def _checked_numbers(name: str, numbers: Any, count: int) -> tuple[float, ...]:
    expected = "x and y (m)" if count == 2 else "x, y (m) and heading (rad)"
    if (
        not isinstance(numbers, list | tuple)
        or len(numbers) != count
        or not all(isinstance(one, int | float) and not isinstance(one, bool) for one in numbers)
        or not all(math.isfinite(one) and abs(one) <= MAX_M for one in numbers)
    ):
        raise AnnotationError(f"{name!r}: expected {expected} within {MAX_M:g} m, not {numbers!r:.80}")
    return tuple(map(float, numbers))


def _plain(annotations: Annotations) -> dict[str, Any]:
    return {
        "no_go": {name: [list(corner) for corner in corners] for name, corners in annotations.no_go.items()},
        "places": {name: list(place) for name, place in annotations.places.items()},
    }


def _from_plain(described: Mapping[str, Any]) -> Annotations:
    no_go, places = described.get("no_go") or {}, described.get("places") or {}
    if not isinstance(no_go, dict) or not isinstance(places, dict):
        raise AnnotationError("no_go and places must map names to coordinates")
    if any(name == "" for name in no_go):
        raise AnnotationError("an area has no name")
    return Annotations().changed((), no_go.items(), places.items())
