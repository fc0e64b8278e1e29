"""The buttons of a tile's tools."""

from __future__ import annotations

from nicegui import ui


def tool_button(icon: str, name: str, label: str) -> ui.button:
    """Build a small button that shows an icon.

    Args:
        icon: name of a Material Icon.
        name: the element's id.
        label: what it does, in words; shown when a pointer rests on it.
    """
    button = ui.button(icon=icon, color=None).classes("tool-button").props(f"unelevated dense id={name}")
    button.props["aria-label"] = button.props["title"] = label
    return button
