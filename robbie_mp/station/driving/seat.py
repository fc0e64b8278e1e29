"""The driver's seat: one page drives at a time."""


class DriversSeat:
    """Allows at most one page at a time to drive. Another page takes over only by an explicit action."""

    def __init__(self) -> None:
        self.holder: str | None = None

    def take(self, page: str, *, over: bool = False) -> bool:
        """Let a page drive if no other page does, or if it takes over. Return whether it may drive now."""
        if self.holder is None or over:
            self.holder = page
        return self.holder == page

    def leave(self, page: str) -> None:
        """End driving by a page."""
        if self.holder == page:
            self.holder = None
