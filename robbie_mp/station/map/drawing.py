"""Drawings of operators on the map: no-go areas and named places. The server of `AnnotateMap` keeps it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from nicegui import ui

from robbie_mp.messages import (
    AnnotateMap,
    MapAnnotations,
    NavigateTo,
    NoGoArea,
    Point,
    PointOfInterest,
    Pose,
    Quaternion,
    UndoMapAnnotation,
)
from robbie_mp.station.map.card import MapCard
from robbie_mp.station.page.menus import commands, popup
from robbie_mp.station.page.page import Page
from robbie_mp.station.page.tool_button import tool_button
from robbie_mp.station.watch.latest import Latest

NO_GO, PLACE = "no_go", "place"
DRAWN = {NO_GO: "Draw a no-go area", PLACE: "Name a place"}
"""Kinds of drawings, each with the text of the menu."""
MAX_CORNERS = 256
"""Maximum number of corners that a page may send; the server of `AnnotateMap` has a lower limit."""


class MapDrawing:
    """The menu with which an operator draws on the map, removes drawings, and sends the robot to places.

    Args:
        page: the operator's page.
        annotations: the newest annotations; without any, no module keeps them, and the menu is hidden.
        draw: called with the kind of drawing that the operator begins, one of `DRAWN`.
        card: asks for names.
    """

    def __init__(
        self,
        page: Page,
        annotations: Latest[MapAnnotations],
        draw: Callable[[str], None],
        card: MapCard,
    ):
        self._page = page
        self._card = card
        self._annotations = annotations
        self._shown = 0
        self._button = tool_button("edit_location_alt", "map-draw", "No-go areas and places")
        with self._button, popup("No-go areas and places", "map-drawings"):
            with commands():
                for what, text in DRAWN.items():
                    item = ui.menu_item(text, on_click=lambda what=what: draw(what))
                    item.props(f"id=map-draw-{what}")
                undo = ui.menu_item("Undo the last change", on_click=self._undo)
                undo.props("id=map-draw-undo")
            ui.separator()
            self._list = ui.column().classes("q-px-sm gap-0")

    def tick(self) -> None:
        """List the areas and places, if they have changed."""
        newest = self._annotations.message
        self._button.set_visibility(newest is not None)
        if newest is None or self._annotations.count == self._shown:
            return
        self._shown = self._annotations.count
        self._list.clear()
        with self._list:
            for place in newest.places:
                self._build_entry(place.name, is_place=True)
            for area in newest.no_go:
                self._build_entry(area.name, is_place=False)

    async def outlined(self, sent: Any) -> None:
        """Ask for the name of an area whose corners the page's script has sent, then save it."""
        corners = checked_corners(sent)
        if corners is not None:
            await self._card.name(NoGoArea(corners=corners))

    async def pointed(self, sent: Any) -> None:
        """Ask for the name of a place that the page's script has sent, then save it."""
        pose = checked_place(sent)
        if pose is not None:
            await self._card.name(PointOfInterest(pose=pose))

    def _undo(self) -> None:
        self._page.ask(UndoMapAnnotation(), "the undo", "the last change of the map is taken back")

    def _build_entry(self, name: str, *, is_place: bool) -> None:
        with ui.row().classes("items-center no-wrap full-width"):
            if is_place:
                ui.button(f"Go to {name}", icon="near_me", on_click=lambda: self._go(name)).props(
                    "flat no-caps dense"
                )
            else:
                ui.icon("block")
                ui.label(name)
            ui.space()
            remove = ui.button(icon="delete", on_click=lambda: self._remove(name)).props("flat dense")
            remove.props["aria-label"] = f"Remove {name}"

    def _go(self, name: str) -> None:
        self._page.ask(NavigateTo(place=name), "the goal", f"the robot is at {name}", moves=True)

    def _remove(self, name: str) -> None:
        self._page.ask(AnnotateMap(remove=[name]), "the removal", f"{name} is removed")


def checked_corners(sent: Any) -> list[Point] | None:
    """Return the corners that a page's script has sent, or None if they are malformed."""
    try:
        corners = [(float(x_m), float(y_m)) for x_m, y_m in sent["corners"][:MAX_CORNERS]]
    except (KeyError, TypeError, ValueError):
        return None
    if len(corners) < 3 or not all(math.isfinite(number) for corner in corners for number in corner):
        return None
    return [Point(x=x_m, y=y_m) for x_m, y_m in corners]


def checked_place(sent: Any) -> Pose | None:
    """Return the place that a page's script has sent, or None if it is malformed."""
    try:
        numbers = [float(sent["x_m"]), float(sent["y_m"]), float(sent["yaw_rad"] or 0.0)]
    except (KeyError, TypeError, ValueError):
        return None
    if not all(map(math.isfinite, numbers)):
        return None
    x_m, y_m, yaw_rad = numbers
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))


def area_marks(annotations: MapAnnotations | None) -> list[dict[str, Any]]:
    """Return the drawing data of all no-go areas."""
    areas = annotations.no_go if annotations else []
    return [
        {"name": area.name, "corners": [[round(one.x, 3), round(one.y, 3)] for one in area.corners]}
        for area in areas
    ]
