"""A slider that hears each key."""

from nicegui import ui


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
