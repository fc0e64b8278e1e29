"""The newest picture at an address of the page server."""

from nicegui.element import Element


class NewestImage(Element, component="newest_image.js"):
    """Shows a picture, and the next one once it has this one.

    Args:
        address: where pictures are.
        description: for who does not see it.
    """

    def __init__(self, address: str, description: str):
        super().__init__()
        self._props["address"] = address
        self._props["alt"] = description
        self.show(0)

    def show(self, count: int) -> None:
        """Show the picture that is the newest now, if that is another one.

        Args:
            count: of the message it is made of; 0: there is none.
        """
        if self._props.get("count") != count:
            self._props["count"] = count
            self.update()
