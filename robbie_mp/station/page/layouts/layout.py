"""Layouts of the page: which panels it shows as tiles, and where. Profiles can add others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robbie_mp.base.errors import RobbieError

COLUMNS = ROWS = 24
"""The grid on which tiles lie fills the page, whatever its size."""
MIN_SIZE = 2
"""Minimum width and height of a tile, in cells."""
MAX_NAME_CHARACTERS = 30
OWN = "*"
"""In the station's layouts: the robot's own panels, the first of them where there is room for one."""


class LayoutError(RobbieError, ValueError):
    """A layout is not possible.

    Example scenarios:
      - a tile lies outside the grid, or on another one
      - a tile is for a panel that the page does not have
    """


@dataclass(frozen=True)
class Tile:
    """The place of a panel on the grid, in cells, from the top left corner."""

    panel: str
    x: int
    y: int
    width: int
    height: int

    @property
    def cells(self) -> set[tuple[int, int]]:
        """The cells that it covers."""
        return {
            (x, y) for x in range(self.x, self.x + self.width) for y in range(self.y, self.y + self.height)
        }


Layout = tuple[Tile, ...]

DEFAULTS: Mapping[str, Mapping[str, Sequence[int]]] = {
    "Drive": {
        "camera": (0, 0, 14, 15),
        "map": (14, 0, 10, 13),
        "view": (14, 13, 10, 11),
        "drive": (0, 15, 7, 9),
        OWN: (7, 15, 7, 9),
    },
    "Mission": {
        "map": (0, 0, 14, 16),
        "camera": (14, 0, 10, 10),
        OWN: (14, 10, 10, 14),
        "trace": (0, 16, 14, 8),
    },
    "Engineer": {
        "system": (0, 0, 14, 13),
        "plots": (14, 0, 10, 11),
        "trace": (0, 13, 14, 11),
        "messages": (14, 11, 10, 13),
    },
    "Tablet": {
        "camera": (0, 0, 15, 15),
        "map": (15, 0, 9, 24),
        "drive": (0, 15, 15, 9),
    },
    "Playback": {
        "map": (0, 0, 9, 24),
        "camera": (9, 0, 8, 13),
        "view": (17, 0, 7, 13),
        "plots": (9, 13, 8, 11),
        "trace": (17, 13, 7, 11),
    },
}
"""The station's own layouts: x, y, width and height of each panel."""
UPRIGHT_DEFAULTS: Mapping[str, Mapping[str, Sequence[int]]] = {
    "Drive": {
        "camera": (0, 0, 24, 9),
        "map": (0, 9, 12, 8),
        "view": (12, 9, 12, 8),
        "drive": (0, 17, 12, 7),
        OWN: (12, 17, 12, 7),
    },
    "Mission": {
        "map": (0, 0, 24, 10),
        "camera": (0, 10, 12, 7),
        OWN: (12, 10, 12, 7),
        "trace": (0, 17, 24, 7),
    },
    "Engineer": {
        "system": (0, 0, 24, 9),
        "plots": (0, 9, 12, 8),
        "messages": (12, 9, 12, 8),
        "trace": (0, 17, 24, 7),
    },
    "Tablet": {
        "camera": (0, 0, 24, 9),
        "map": (0, 9, 24, 8),
        "drive": (0, 17, 24, 7),
    },
    "Playback": {
        "camera": (0, 0, 24, 9),
        "map": (0, 9, 12, 9),
        "view": (12, 9, 12, 9),
        "plots": (0, 18, 12, 6),
        "trace": (12, 18, 12, 6),
    },
}
"""The same layouts for a page that is higher than wide, such as that of a tablet held upright."""
MAX_OF_ALL = 4
"""Number of panels that a layout shows if none of the layouts fits the page."""
PORTRAIT = "Tablet"
"""The layout for a page that is higher than wide and has never had another one."""
PLAYBACK = "Playback"
"""The layout for a page that has never had another one, when a log plays."""


def check_layout(name: str, places: Mapping[str, Any], known: Iterable[str]) -> Layout:
    """Return a layout.

    Args:
        name: its name.
        places: x, y, width and height of each panel, in cells.
        known: names of all panels.

    Raises:
        LayoutError: the name or a place is impossible, or there is no such panel.
    """
    check_name(name)
    known = list(known)
    tiles: list[Tile] = []
    for panel, place in places.items():
        if panel not in known:
            raise LayoutError(f"{name}: there is no panel {panel!r:.40}; expected one of {', '.join(known)}")
        tile = _tile(name, panel, place)
        for other in tiles:
            if tile.cells & other.cells:
                raise LayoutError(f"{name}: the tiles of {other.panel} and {panel} overlap")
        tiles.append(tile)
    return tuple(tiles)


def check_name(name: str) -> None:
    """Check the name of a layout.

    Raises:
        LayoutError: it is empty, too long, or cannot be printed.
    """
    if not name.strip() or len(name) > MAX_NAME_CHARACTERS or not name.isprintable():
        raise LayoutError(f"a layout's name has 1 to {MAX_NAME_CHARACTERS} characters; got {name!r:.60}")


def _tile(name: str, panel: str, place: object) -> Tile:
    numbers = list(place) if isinstance(place, list | tuple) else []
    if len(numbers) != 4 or not all(type(number) is int for number in numbers):
        raise LayoutError(f"{name}: {panel} needs [x, y, width, height] in cells; got {place!r:.60}")
    tile = Tile(panel, *numbers)
    if not _is_inside(tile) or tile.width < MIN_SIZE or tile.height < MIN_SIZE:
        raise LayoutError(
            f"{name}: {panel} at {numbers} does not fit: the grid has {COLUMNS} columns and {ROWS} rows, "
            f"and a tile at least {MIN_SIZE} of each"
        )
    return tile


def default_layouts(
    available: Sequence[str], own: Sequence[str], *, upright: bool = False
) -> dict[str, Layout]:
    """Return the station's layouts for the panels that a page has.

    A tile without a panel is left out, and its neighbours grow into the gap. A layout of which a page
    lacks more than half of the panels is left out; if all are, the page has a layout with its first panels.

    Args:
        available: names of the page's panels.
        own: names of the robot's own panels; the first one that is available gets the tile for them.
        upright: for a page that is higher than wide.
    """
    first = next((name for name in own if name in available), None)
    found: dict[str, Layout] = {}
    for name, places in (UPRIGHT_DEFAULTS if upright else DEFAULTS).items():
        tiles = [Tile(first if panel == OWN and first else panel, *place) for panel, place in places.items()]
        kept = [tile for tile in tiles if tile.panel in available]
        if 2 * len(kept) >= sum(panel != OWN for panel in places):
            found[name] = without_gaps(kept)
    if not found:
        layout: Layout = ()
        for panel in available[:MAX_OF_ALL]:
            layout = with_panel(layout, panel)
        found["All"] = layout
    return found


def without_gaps(tiles: Sequence[Tile]) -> Layout:
    """Let each tile in turn grow in all directions, as far as nothing lies there."""
    grown = list(tiles)
    for index, tile in enumerate(grown):
        taken = {cell for other in grown if other is not tile for cell in other.cells}
        for left, up, right, down in ((0, 0, 1, 0), (0, 0, 0, 1), (1, 0, 0, 0), (0, 1, 0, 0)):
            while _is_free(wider := _widened(grown[index], left, up, right, down), taken):
                grown[index] = wider
    return tuple(grown)


def _widened(tile: Tile, left: int, up: int, right: int, down: int) -> Tile:
    """Return a tile with more cells at its sides."""
    x, y = tile.x - left, tile.y - up
    return Tile(tile.panel, x, y, tile.width + left + right, tile.height + up + down)


def _is_free(tile: Tile, taken: set[tuple[int, int]]) -> bool:
    return _is_inside(tile) and not tile.cells & taken


def _is_inside(tile: Tile) -> bool:
    return tile.x >= 0 and tile.y >= 0 and tile.x + tile.width <= COLUMNS and tile.y + tile.height <= ROWS


def with_panel(layout: Layout, panel: str) -> Layout:
    """Return a layout with one more tile: in the largest free area, or in a half of the largest tile."""
    if any(tile.panel == panel for tile in layout):
        return layout
    taken = {cell for tile in layout for cell in tile.cells}
    free = [
        (size * size, x, y, size)
        for size in range(4, COLUMNS + 1)
        for x in range(COLUMNS - size + 1)
        for y in range(ROWS - size + 1)
        if not any((x + i, y + j) in taken for i in range(size) for j in range(size))
    ]
    if free:
        _, x, y, size = max(free)
        return (*layout, without_gaps([*layout, Tile(panel, x, y, size, size)])[-1])
    largest = max(layout, key=lambda tile: tile.width * tile.height)
    if largest.width >= largest.height:
        kept = replace(largest, width=largest.width // 2)
        new = replace(largest, panel=panel, x=kept.x + kept.width, width=largest.width - kept.width)
    else:
        kept = replace(largest, height=largest.height // 2)
        new = replace(largest, panel=panel, y=kept.y + kept.height, height=largest.height - kept.height)
    return (*(kept if tile is largest else tile for tile in layout), new)


def places_of(layout: Layout) -> dict[str, list[int]]:
    """Return a layout as profiles and files have it."""
    return {tile.panel: [tile.x, tile.y, tile.width, tile.height] for tile in layout}
