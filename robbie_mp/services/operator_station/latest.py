"""The newest message of a kind, for who looks when it suits him."""

from collections.abc import Callable
from typing import Generic

from robbie_mp.bus import MessageType


class Latest(Generic[MessageType]):
    """The newest message of a kind: put here by the module's thread, looked at by the pages'.

    Attributes:
        message: None before the first one.
        count: how many there have been, so that a page can tell whether it has shown this one.
        listeners: are called with each one, in the module's thread.
    """

    def __init__(self) -> None:
        self.message: MessageType | None = None
        self.count = 0
        self.listeners: list[Callable[[MessageType], None]] = []

    def put(self, message: MessageType) -> None:
        """Take the place of the one before."""
        self.message = message
        self.count += 1
        for listener in tuple(self.listeners):
            listener(message)
