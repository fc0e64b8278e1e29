"""The newest message of a kind, for who looks when it suits him."""

import threading
import time
from collections.abc import Callable
from typing import Generic

from robbie_mp.module.bus import MessageType


class Latest(Generic[MessageType]):
    """The newest message of a kind: put here by the module's thread, looked at by the pages'.

    Attributes:
        message: None before the first one.
        count: how many there have been, so that a page can tell whether it has shown this one.
    """

    def __init__(self) -> None:
        self.message: MessageType | None = None
        self.count = 0
        self._put_s = 0.0
        self._lock = threading.Lock()
        self._listeners: tuple[Callable[[MessageType], None], ...] = ()

    @property
    def age_s(self) -> float | None:
        """How long ago the newest message came; None before the first one."""
        return time.monotonic() - self._put_s if self.count else None

    def put(self, message: MessageType) -> None:
        """Take the place of the one before."""
        self._put_s = time.monotonic()
        self.message = message
        self.count += 1
        for listener in self._listeners:
            listener(message)

    def listen(self, listener: Callable[[MessageType], None]) -> None:
        """Have something called with each message, in the module's thread; any thread may ask for that."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def ignore(self, listener: Callable[[MessageType], None]) -> None:
        """Stop calling it."""
        with self._lock:
            self._listeners = tuple(one for one in self._listeners if one is not listener)
