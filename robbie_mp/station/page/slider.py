"""A slider that hears each key."""

import math
from collections import deque
from collections.abc import Callable

from nicegui import ui
from nicegui.events import GenericEventArguments


class Slider(ui.slider):
    """A slider that moves in the browser at once, and not only when the server has answered.

    Otherwise a key that takes back the one before it, pressed before that answer, would mean no change to the
    browser, and be lost.
    """

    LOOPBACK = False

    def show(self, least: float, most: float) -> None:
        """Change the ends of the slider."""
        if (self.props["min"], self.props["max"]) != (least, most):
            self.props["min"], self.props["max"] = least, most
            self.update()

    def on_chosen(self, choose: Callable[[float], None]) -> "Slider":
        """Call back with what a visitor has chosen, when the key or the pointer is released.

        The robot may change the value before that, and then the slider's own value is not the visitor's.
        """
        chosen: deque[object] = deque(maxlen=1)

        def on_release(event: GenericEventArguments) -> None:
            value = chosen.pop() if chosen else event.args
            if isinstance(value, int | float) and math.isfinite(value):
                choose(value)

        # Only the visitor causes these two.
        self.on("update:model-value", lambda event: chosen.append(event.args))
        return self.on("change", on_release)
