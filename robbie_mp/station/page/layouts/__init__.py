"""Layouts of the page: where tiles of its panels lie, given by the station, by profiles and by operators."""

from robbie_mp.station.page.layouts.collection import LayoutCollection
from robbie_mp.station.page.layouts.layout import (
    PLAYBACK,
    PORTRAIT,
    Layout,
    LayoutError,
    Tile,
    check_layout,
    default_layouts,
    places_of,
    with_panel,
)

__all__ = [
    "PLAYBACK",
    "PORTRAIT",
    "Layout",
    "LayoutCollection",
    "LayoutError",
    "Tile",
    "check_layout",
    "default_layouts",
    "places_of",
    "with_panel",
]
