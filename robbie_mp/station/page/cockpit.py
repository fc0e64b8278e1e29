"""The tiles of one page: which panels it shows and where, and the buttons to change that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from nicegui import ui
from nicegui.element import Element

from robbie_mp.station.page.grid import TileFrame, TileGrid
from robbie_mp.station.page.layouts import (
    PLAYBACK,
    PORTRAIT,
    Layout,
    LayoutCollection,
    LayoutError,
    check_layout,
    with_panel,
)
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.station.page.page import Page
    from robbie_mp.station.panel import Panel

TAB = "tab"
LAYOUT = "layout"
TILE_PATH = "/tile/"
"""Beginning of the path of a page that shows one panel, such as `/tile/map`."""
LOOK_S = 0.5
"""Time between two looks whether a log plays."""
POP_OUT = "() => window.open(`${{window.path_prefix}}{path}`, '_blank', 'popup,width=900,height=700')"


class Cockpit:
    """The grid of one page.

    Args:
        page: the page.
        layouts: the layouts that it can show.
        panels: each with its title.
        single: the only panel of the page, which fills it; '': the page has layouts.
        plays_log: returns whether a log plays.
    """

    def __init__(
        self,
        page: Page,
        layouts: LayoutCollection,
        panels: Sequence[tuple[Panel, str]],
        single: str = "",
        plays_log: Callable[[], bool] = lambda: False,
    ):
        self._page = page
        self._layouts = layouts
        self._panels = {panel.name: (panel, title) for panel, title in panels}
        self._single = single
        self._plays_log = plays_log
        self._is_chosen = True
        self._is_upright = False
        self._name = ""
        self._layout: Layout = ()
        self._alone = single
        self._frames: dict[str, TileFrame] = {}
        self._waiting: dict[str, Element] = {}
        """The bodies of the tiles whose panels have not been built yet."""
        self._heads: dict[str, TileHead] = {}
        self._tabs: dict[str, ui.button] = {}

    @property
    def names(self) -> list[str]:
        """Names of all layouts."""
        return [] if self._single else self._layouts.names

    def build(self, layout: str, alone: str) -> None:
        """Build rail and tiles.

        Args:
            layout: the layout to show first; '': the first one that fits the browser's window.
            alone: the panel to show alone; '': none.
        """
        with ui.element("div").classes("cockpit-middle"):
            if not self._single:
                self._build_rail()
            self._grid = TileGrid(is_fixed=bool(self._single))
            self._grid.on("arranged", self._on_arranged)
            with self._grid:
                for name, (panel, title) in self._panels.items():
                    if self._single in ("", name):
                        self._build_tile(panel, title)
        if self._single:
            self._show()
            return
        if self._layouts.get(layout) is None:
            layout = self.names[0]
            self._is_chosen = False
            self._page.always(LOOK_S, self._turn_to_playback)
        self._grid.on("turned", self._on_turned)
        self._alone = alone if alone in self._panels else ""
        self._name, self._layout = layout, self._layouts.get(layout) or ()
        self._show()

    def _build_rail(self) -> None:
        with ui.element("nav").classes("cockpit-rail").props('aria-label="Panels" id=panels'):
            for name, (panel, title) in self._panels.items():
                button = ui.button(icon=panel.icon, color=None).props(f"flat dense id=tab-{name}")
                button.on_click(lambda name=name: self.show_alone(name))
                button.props["aria-label"] = button.props["title"] = title
                self._tabs[name] = button

    def _build_tile(self, panel: Panel, title: str) -> None:
        name = panel.name
        with TileFrame(name) as frame, ui.element("section").classes("grid-stack-item-content tile") as tile:
            tile.props["aria-label"] = title
            self._heads[name] = TileHead(self, panel, title, is_fixed=bool(self._single))
            body = ui.element("div").classes("tile-body").props(f"id=panel-{name} tabindex=-1")
        self._frames[name], self._waiting[name] = frame, body
        if not panel.is_built_when_shown:
            self._build_panel(name)

    def _build_panel(self, name: str) -> None:
        """Build what is in a tile, unless it is there already."""
        if (body := self._waiting.pop(name, None)) is not None:
            with body:
                self._panels[name][0].build(self._page)

    def build_menu(self) -> None:
        """Build the button with the layouts."""
        if self._single:
            return
        with ui.button(icon="dashboard").props("flat dense no-caps color=white id=layouts") as self._button:
            self._button.props["title"] = "Layouts"
            # The browser does not open it by itself: it would show what is about to be replaced.
            self._menu = ui.menu().props("id=layouts-menu auto-close no-parent-event")
        self._button.on_click(self._open_menu)
        with ui.dialog() as self._dialog, ui.card():
            ui.label("Save this layout under a name")
            self._field = ui.input("Name").props("for=layout-name maxlength=30 autofocus")
            self._field.on("keyup.enter", self._save_as)
            with ui.row():
                ui.button("Save", on_click=self._save_as).props("id=layout-save")
                ui.button("Cancel", on_click=self._dialog.close).props("flat")

    def _open_menu(self) -> None:
        self._menu.clear()
        with self._menu:
            for number, name in enumerate(self.names, 1):
                text = f"{number}  {name}" if number < 10 else name
                changed = " (changed)" if self._layouts.is_changed(name) else ""
                item = ui.menu_item(text + changed, lambda name=name: self.choose(name))
                item.props["data-layout"] = name
            if self._page.role is Role.OPERATOR:
                ui.separator()
                ui.menu_item("Save as …", self._dialog.open).props("id=layout-save-as")
                if self._layouts.is_changed(self._name):
                    text = f"Undo all changes of {self._name}"
                    ui.menu_item(text, self._reset).props("id=layout-reset")
        self._menu.open()

    def choose(self, name: str) -> None:
        """Show a layout."""
        layout = self._layouts.get(name, upright=self._is_upright)
        if layout is not None and not self._single:
            self._is_chosen = True
            self._name, self._layout, self._alone = name, layout, ""
            self._show()

    def show_alone(self, panel: str) -> None:
        """Let one panel fill the grid, also one that the layout does not have."""
        if panel in self._panels and not self._single:
            self._is_chosen = True
            self._alone = panel
            self._show()

    def show_all(self) -> None:
        """Show the layout again after a single panel."""
        if not self._single:
            self._alone = ""
            self._show()

    def turn(self, panel: str) -> None:
        """Maximise a panel's tile, or restore it."""
        if self._alone == panel:
            self.show_all()
        else:
            self.show_alone(panel)

    def add_or_remove(self, panel: str) -> None:
        """Add a panel to the layout, or remove it."""
        left = tuple(tile for tile in self._layout if tile.panel != panel)
        self._layout = left if len(left) < len(self._layout) else with_panel(self._layout, panel)
        self._alone = ""
        self._is_chosen = True
        self._keep()
        self._show()

    def has(self, panel: str) -> bool:
        """Whether the layout has a tile for a panel."""
        return any(tile.panel == panel for tile in self._layout)

    def _keep(self) -> None:
        """Save the layout as it is now. What an observer changes is for this page alone."""
        if self._page.role is not Role.OPERATOR:
            return
        try:
            self._layouts.save(self._name, self._layout, upright=self._is_upright)
        except LayoutError as error:
            ui.notify(str(error), type="negative")

    def _save_as(self) -> None:
        if not self._page.may("saving a layout"):
            return
        name = str(self._field.value or "").strip()
        try:
            self._layouts.save(name, self._layout, upright=self._is_upright)
        except LayoutError as error:
            ui.notify(str(error), type="negative")
            return
        self._dialog.close()
        self.choose(name)
        ui.notify(f"the layout {name} is saved")

    def _reset(self) -> None:
        if self._page.may("changing a layout"):
            self._layouts.forget(self._name)
            self.choose(self._name if self._layouts.get(self._name) is not None else self.names[0])

    def _on_arranged(self, event: GenericEventArguments) -> None:
        try:
            moved: Layout = check_layout(self._name, dict(event.args), [tile.panel for tile in self._layout])
        except (LayoutError, TypeError, ValueError):
            self._grid.show(self._layout, self._alone)
            return
        if len(moved) == len(self._layout) and set(moved) != set(self._layout):
            self._layout = moved
            self._keep()
            self._grid.show(self._layout, self._alone)

    def _on_turned(self, event: GenericEventArguments) -> None:
        """Show the layout for the shape of the window, which the page tells at first and when it changes."""
        if not isinstance(event.args, dict):
            return
        self._is_upright = event.args.get("portrait") is True
        self._grid.turn(upright=self._is_upright)
        if self._is_upright and not self._is_chosen:
            self._begin_with(PORTRAIT)
        layout = self._layouts.get(self._name, upright=self._is_upright)
        if layout is not None and layout != self._layout:
            self._layout = layout
            self._show()

    def _turn_to_playback(self) -> None:
        if not self._is_chosen and self._plays_log():
            self._begin_with(PLAYBACK)

    def _begin_with(self, name: str) -> None:
        """Show a layout on a page where nobody has chosen one yet."""
        layout = self._layouts.get(name, upright=self._is_upright)
        if layout is not None and not self._is_chosen:
            self._is_chosen = True
            self._name, self._layout = name, layout
            self._show()

    def _show(self) -> None:
        in_layout = {tile.panel for tile in self._layout}
        shown = {self._alone} if self._alone else in_layout
        self._page.show(frozenset(shown))
        for name, frame in self._frames.items():
            if name in shown:
                self._build_panel(name)
            frame.show(name in shown)
            self._heads[name].show(is_alone=name == self._alone, is_in_layout=name in in_layout)
        self._grid.show(self._layout, self._alone)
        for name, button in self._tabs.items():
            _mark(button, "is-in-layout", name in in_layout)
            _mark(button, "is-alone", name == self._alone)
            button.props["aria-pressed"] = "true" if name in shown else "false"
        if not self._single:
            self._button.set_text(self._name)
            alone = f"&{TAB}={quote(self._alone)}" if self._alone else ""
            ui.navigate.history.replace(f"?{LAYOUT}={quote(self._name)}{alone}")  # for a reload of the page


class TileHead:
    """The bar at the top of a tile, by which it is dragged.

    Args:
        cockpit: the tile's grid.
        panel: the panel in the tile.
        title: its title.
        is_fixed: whether the page has only this tile.
    """

    def __init__(self, cockpit: Cockpit, panel: Panel, title: str, *, is_fixed: bool):
        name = panel.name
        with ui.element("header").classes("tile-head"):
            ui.icon(panel.icon)
            ui.label(title).classes("title")
            if is_fixed:
                return
            self._size = _tool("open_in_full", f"maximise-{name}", lambda: cockpit.turn(name))
            pop_out = _tool("open_in_new", f"pop-out-{name}", None)
            pop_out.on("click", js_handler=POP_OUT.format(path=f"{TILE_PATH}{quote(name)}"))
            _label(pop_out, f"{title}: second window")
            self._close = _tool("close", f"close-{name}", lambda: cockpit.add_or_remove(name))
        self._title = title

    def show(self, *, is_alone: bool, is_in_layout: bool) -> None:
        """Show what the buttons do now."""
        if not hasattr(self, "_size"):
            return
        self._size.set_icon("close_fullscreen" if is_alone else "open_in_full")
        _label(self._size, f"{self._title}: {'back to the layout' if is_alone else 'maximise'}")
        self._close.set_icon("close" if is_in_layout else "add")
        _label(self._close, f"{self._title}: {'remove from' if is_in_layout else 'add to'} the layout")


def _tool(icon: str, name: str, on_click: Any) -> ui.button:
    return ui.button(icon=icon, color=None, on_click=on_click).props(f"flat dense id={name}")


def _label(button: ui.button, text: str) -> None:
    button.props["aria-label"] = button.props["title"] = text


def _mark(element: Element, name: str, wanted: bool) -> None:
    element.classes(add=name if wanted else "", remove="" if wanted else name)
