"""The grid of tiles in the browser, drawn by GridStack, which comes with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nicegui.element import Element

from robbie_mp.station.page.layouts.layout import Layout, places_of

HERE = Path(__file__).parent
SCRIPTS = {"robbie-gridstack": str(HERE / "scripts")}
STYLES = (HERE / "scripts" / "gridstack.min.css", HERE / "tiles.css")


class TileGrid(Element, component="tile_grid.js", esm=SCRIPTS):
    """Lays out its children, which are tiles.

    It emits `arranged` when the visitor has moved a tile, and `turned` with the shape of the browser's window
    until `turn` has been called with it: events of a page that is just being connected may be lost.

    Args:
        is_fixed: whether tiles cannot be moved.
    """

    def __init__(self, *, is_fixed: bool):
        super().__init__()
        self._props["fixed"] = is_fixed
        self._props["places"] = {}
        self._props["alone"] = ""
        self._props["upright"] = None

    def turn(self, *, upright: bool) -> None:
        """Confirm whether the window is higher than wide."""
        self._props["upright"] = upright
        self.update()

    def show(self, layout: Layout, alone: str) -> None:
        """Show the tiles of a layout.

        Args:
            layout: the places of the tiles.
            alone: the panel that fills the grid; '': none.
        """
        self._props["places"] = places_of(layout)
        self._props["alone"] = alone
        self.update()


class TileFrame(Element, component="tile_frame.js"):
    """A tile. The browser creates what is in it when it is shown for the first time."""

    def __init__(self, panel: str):
        super().__init__()
        self._props.update({"panel": panel, "shown": False, "id": f"tile-{panel}"})
        self.classes("grid-stack-item")

    def show(self, shown: bool) -> None:
        """Show or hide the tile."""
        changed: dict[str, Any] = {"shown": shown}
        if changed.items() - self._props.items():
            self._props.update(changed)
            self.update()
