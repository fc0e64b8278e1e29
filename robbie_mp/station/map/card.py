"""The card beside the map: it names what was just drawn, and acts on the mark that was pressed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from nicegui import ui

from robbie_mp.messages import AnnotateMap, NavigateTo, NoGoArea, Point, PointOfInterest
from robbie_mp.station.map.goals import GOAL, Placement, checked
from robbie_mp.station.page.tool_button import tool_button

if TYPE_CHECKING:
    from nicegui.elements.mixins.visibility import Visibility

    from robbie_mp.messages import MapAnnotations
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.latest import Latest

PLACE, AREA = "place", "area"
"""Kinds of marks that operators have drawn; others are modules'."""
MAX_NAME = 64
UNDO_S = 8.0
"""For how long a mark that was deleted can be brought back by the card."""
Drawing = NoGoArea | PointOfInterest


class MapEdges(Protocol):
    """What the card does on the map of its page."""

    def draft(self, drawing: Drawing | None) -> None:
        """Draw what has no name yet; None: nothing."""

    def show(self, x_m: float, y_m: float) -> None:
        """Bring a place into the middle."""

    def go(self, placement: Placement) -> None:
        """Set a goal."""


class MapCard:
    """One card, at a fixed place over a page's map. It is no dialog: the page works on behind it.

    Args:
        page: the operator's page.
        annotations: what operators have drawn.
        edges: acts on the map.
        area_warnings: return what is wrong with a no-go area that has these corners; '' if nothing is.
    """

    def __init__(
        self,
        page: Page,
        annotations: Latest[MapAnnotations],
        edges: MapEdges,
        area_warnings: Sequence[Callable[[Sequence[Point]], str]] = (),
    ):
        self._page, self._annotations, self._edges = page, annotations, edges
        self._area_warnings = area_warnings
        self._draft: Drawing | None = None
        self._removed: Drawing | None = None
        self._pressed: tuple[str, str, float, float] = ("", "", 0.0, 0.0)
        self._build()

    def _build(self) -> None:
        with ui.element("section").classes("map-card").props("id=map-card") as self._card:
            self._card.props["aria-label"] = "Mark on the map"
            with ui.row().classes("w-full items-center no-wrap"):
                self._title = ui.label("").classes("map-card-title")
                ui.space()
                tool_button("close", "map-card-close", "Close").on_click(self.close)
            self._warning = ui.label("").props("id=map-draw-warning role=alert").classes("text-negative")
            self._name = ui.input("Name").props(f"for=map-card-name dense maxlength={MAX_NAME}")
            self._name.on("keyup.enter", self._save)
            with ui.row().classes("map-card-buttons"):
                self._go = _button("Go", "near_me", "map-card-go", self._drive)
                self._show = _button("Show", "my_location", "map-card-show", self._look)
                self._keep = _button("Save", "check", "map-card-save", self._save)
                self._delete = _button("Delete", "delete", "map-card-delete", self._remove)
                self._undo = _button("Undo", "undo", "map-card-undo", self._bring_back)
        self._undo_ends = ui.timer(UNDO_S, self.close, active=False, immediate=False)
        self._card.set_visibility(False)

    def _open(self, title: str, *shown: Visibility) -> None:
        self._undo_ends.deactivate()
        self._title.set_text(title)
        self._warning.set_text("")
        for one in (self._name, self._go, self._show, self._keep, self._delete, self._undo):
            one.set_visibility(one in shown)
        self._card.set_visibility(True)

    def close(self) -> None:
        """Forget what has no name yet, and what could be brought back."""
        self._undo_ends.deactivate()
        self._draft = self._removed = None
        self._edges.draft(None)
        self._card.set_visibility(False)

    async def name(self, drawing: Drawing) -> None:
        """Ask for the name of what was just drawn. What is wrong with it stands beside the question."""
        self._draft = drawing
        self._edges.draft(drawing)
        kind = "place" if isinstance(drawing, PointOfInterest) else "no-go area"
        self._open(f"New {kind}", self._name, self._keep)
        free = self._free_name(kind)  # two operators may be offered the same: the server numbers areas itself
        self._name.set_value("" if isinstance(drawing, NoGoArea) else free)
        self._name.run_method("focus")
        self._name.run_method("select")
        if isinstance(drawing, NoGoArea):
            found = [await asyncio.to_thread(warning, drawing.corners) for warning in self._area_warnings]
            if self._draft is drawing:
                self._warning.set_text("; ".join(filter(None, found)))

    def press(self, sent: Any) -> None:
        """Show what can be done with the mark that a page's script says was pressed."""
        if not isinstance(sent, dict) or not isinstance(kind := sent.get("kind"), str):
            return
        place = checked({"what": GOAL, "x_m": sent.get("x_m"), "y_m": sent.get("y_m"), "yaw_rad": None})
        if not kind or place is None:
            self.close()
            return
        self._draft = self._removed = None
        self._edges.draft(None)
        self._pressed = kind, str(sent.get("name", ""))[:MAX_NAME], place.x_m, place.y_m
        self._name.set_value(self._pressed[1])
        is_own = kind in (PLACE, AREA) and self._found(self._pressed[1]) is not None
        own = (self._name, self._keep, self._delete) if is_own else ()
        acts = (*(() if kind == AREA else (self._go,)), *own) if self._page.can_command else ()
        self._open(self._pressed[1] or "mark", self._show, *acts)
        self._keep.set_text("Rename")

    def _free_name(self, kind: str) -> str:
        names = {one.name for one in self._drawn()}
        self._keep.set_text("Save")
        return next(name for number in range(1, len(names) + 2) if (name := f"{kind} {number}") not in names)

    def _drawn(self) -> list[Drawing]:
        newest = self._annotations.message
        return [] if newest is None else [*newest.places, *newest.no_go]

    def _found(self, name: str) -> Drawing | None:
        return next((one for one in self._drawn() if one.name == name), None)

    def _save(self) -> None:
        """Give what was drawn, or the mark that was pressed, the name in the field."""
        name = str(self._name.value or "").strip()
        if self._draft is not None:
            drawing = self._draft
            if self._found(name) is not None:
                self._warning.set_text(f"there is a {name} already")
                return
            self._send(named(drawing, name), f"{name or 'the no-go area'} is saved")
        elif (known := self._found(self._pressed[1])) is not None and name and name != known.name:
            if self._found(name) is not None:
                self._warning.set_text(f"there is a {name} already")
                return
            self._send(named(known, name), f"{known.name} is {name} now", remove=[known.name])
        self.close()

    def _send(self, drawing: Drawing, success: str, remove: Sequence[str] = ()) -> None:
        places = [drawing] if isinstance(drawing, PointOfInterest) else []
        areas = [drawing] if isinstance(drawing, NoGoArea) else []
        self._page.ask(
            AnnotateMap(remove=list(remove), places=places, no_go=areas), "the drawing on the map", success
        )

    def _remove(self) -> None:
        if (known := self._found(self._pressed[1])) is None:
            return
        if self._page.ask(AnnotateMap(remove=[known.name]), "the removal") is None:
            return
        self._removed = known
        self._open(f"{known.name} is removed", self._undo)
        self._undo_ends.activate()

    def _bring_back(self) -> None:
        if self._removed is not None and self._found(self._removed.name) is not None:
            ui.notify(f"there is another {self._removed.name} now", type="negative")
        elif self._removed is not None:
            self._send(self._removed, f"{self._removed.name} is back")
        self.close()

    def _drive(self) -> None:
        kind, name, x_m, y_m = self._pressed
        if kind == PLACE:
            self._page.ask(NavigateTo(place=name), "the goal", f"the robot is at {name}", moves=True)
        elif self._page.may_move("the goal"):
            self._edges.go(Placement(GOAL, x_m, y_m, None))

    def _look(self) -> None:
        self._edges.show(*self._pressed[2:])


def named(drawing: Drawing, name: str) -> Drawing:
    """Return a drawing with another name."""
    if isinstance(drawing, NoGoArea):
        return NoGoArea(name=name, corners=drawing.corners)
    return PointOfInterest(name=name, pose=drawing.pose)


def _button(text: str, icon: str, name: str, action: Callable[[], None]) -> ui.button:
    return ui.button(text, icon=icon, on_click=action, color=None).props(f"unelevated id={name}")
