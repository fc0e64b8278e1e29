"""The newest message of a kind, which panels read at their own rate."""

import threading
import time
from collections.abc import Callable
from typing import Generic, Protocol

from robbie_mp.module.envelope import Envelope, MessageType
from robbie_mp.module.module import MessageHandling


class Latest(Generic[MessageType]):
    """Holds the newest message of a kind. The module's thread writes it; the page server's threads read it.

    Args:
        now_s: the clock of ages.

    Attributes:
        message: None before the first one.
        count: number of messages so far. A page compares it to find out whether it has shown the newest one.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self.message: MessageType | None = None
        self.count = 0
        self._put_s = 0.0
        self._lock = threading.Lock()
        self._listeners: tuple[Callable[[MessageType], None], ...] = ()

    @property
    def age_s(self) -> float | None:
        """Time since the newest message arrived; None before the first one."""
        return max(0.0, self._now_s() - self._put_s) if self.count else None

    @property
    def arrived_s(self) -> float:
        """When the newest message arrived, on the clock of ages; 0 before the first one."""
        return self._put_s

    def put(self, message: MessageType) -> None:
        """Replace the message by a newer one."""
        self._put_s = self._now_s()
        self.message = message
        self.count += 1
        for listener in self._listeners:
            listener(message)

    def listen(self, listener: Callable[[MessageType], None]) -> None:
        """Call a function with each message, in the module's thread. Any thread may call this method."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def ignore(self, listener: Callable[[MessageType], None]) -> None:
        """Stop calling a function."""
        with self._lock:
            self._listeners = tuple(one for one in self._listeners if one is not listener)


class MessageSource(Protocol):
    """The source of the messages that pages show: the operator station."""

    @property
    def envelope(self) -> Envelope:
        """Topic, sender and times of the message that is being handled."""

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        *,
        topic: str = "",
    ) -> None:
        """Subscribe to messages of a type, as `Module.subscribe` does."""

    def newest(self, message_type: type[MessageType], topic: str = "") -> Latest[MessageType]:
        """Return the holder of the newest message of a type and topic; called in the module's thread."""

    def hear(
        self, message_type: type[MessageType], handler: Callable[[MessageType], None], topic: str = ""
    ) -> None:
        """Subscribe to every message of a type and topic; called in the module's thread."""


def silence(age_s: float | None, after_s: float) -> str:
    """Return how long a source has been silent, as text; '' if it is not overdue.

    Args:
        age_s: age of the newest message; None: none has arrived yet.
        after_s: maximum time between two messages of a working source.
    """
    if age_s is None or age_s <= after_s:
        return ""
    if age_s < 120:
        return f"{age_s:.0f} s"
    return f"{age_s / 60:.0f} min" if age_s < 7200 else f"{age_s / 3600:.0f} h"
