"""What a button opens, with the roles by which screen readers know what it is."""

from __future__ import annotations

from nicegui import ui


def popup(label: str, name: str = "") -> ui.menu:
    """Build what a button opens if it has more than commands, such as boxes to tick.

    Args:
        label: what it is for, in words.
        name: the element's id; '': none.
    """
    opened = ui.menu().props("role=dialog")
    opened.props["aria-label"] = label
    if name:
        opened.props["id"] = name
    return opened


def commands() -> ui.element:
    """Build the part of a popup that has menu items."""
    return ui.element("div").props("role=menu")
