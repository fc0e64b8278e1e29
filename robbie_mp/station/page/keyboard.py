"""The keys of a page: every action has one, and `?` lists them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nicegui.events import GenericEventArguments

    from robbie_mp.station.page.page import KeyAction

OPEN = "() => window.dispatchEvent(new CustomEvent('robbie-keys'))"


class Keyboard(Element, component="keyboard.js"):
    """Listens to the keys of actions, and lists all keys.

    Args:
        keys: the keys by name.
    """

    def __init__(self, keys: Mapping[str, KeyAction]):
        super().__init__()
        self._keys = keys
        self._props["keys"] = [[name, key.text, key.action is not None] for name, key in keys.items()]
        self.props("id=keyboard")
        self.on("key", self._on_key)

    async def _on_key(self, event: GenericEventArguments) -> None:
        pressed = event.args.get("key") if isinstance(event.args, dict) else None
        key = self._keys.get(pressed) if isinstance(pressed, str) else None
        if key is not None and key.action is not None:
            ends = key.action()
            if ends is not None:
                await ends


def keys_button() -> None:
    """Build the button that lists the keys."""
    button = ui.button("?").on("click", js_handler=OPEN).props("flat dense color=white id=keys")
    button.props["aria-haspopup"] = "dialog"
    button.props["aria-label"] = button.props["title"] = "Keys"
