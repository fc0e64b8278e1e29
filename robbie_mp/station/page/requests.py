"""Requests of operators to modules: a page asks, the module's thread calls, and the page shows the end."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages import Goal, Message, Request
from robbie_mp.module.calls.errors import CallError, CallNotSent

Asking = Request[Any] | Goal[Any, Any]
MAX_WAITING = 64
"""Maximum number of requests that wait for the module's thread."""


class Asked:
    """A request or a goal of an operator.

    Attributes:
        what: a name for it in texts, such as "the order".
        reply: the reply or the result; None until it arrives.
        error: why there is none; None unless it failed.
    """

    def __init__(self, what: str):
        self.what = what
        self.reply: Message | None = None
        self.error: CallError | None = None

    @property
    def has_ended(self) -> bool:
        """Whether there is a reply or an error."""
        return self.reply is not None or self.error is not None

    def end(self, end: Message | CallError) -> None:
        """Set the reply or the error."""
        if isinstance(end, CallError):
            self.error = end
        else:
            self.reply = end


class Requests:
    """Takes requests in any thread, and makes the calls in the module's thread.

    Args:
        send: makes a call, or sends a goal; gets the message, a function for the end, and the topic.
    """

    def __init__(self, send: Callable[[Asking, Callable[[Message | CallError], None], str], None]):
        self._send = send
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Asking, str, Asked, float]] = deque()

    def ask(self, message: Asking, what: str, topic: str = "", within_s: float | None = None) -> Asked:
        """Take a request or goal; any thread may call this.

        Args:
            message: the request or goal.
            what: a name for it in texts.
            topic: name of the service, if several modules serve the same type.
            within_s: it is not sent later than this; None: however late.
        """
        asked = Asked(what)
        until_s = math.inf if within_s is None else time.monotonic() + within_s
        with self._lock:
            if len(self._waiting) < MAX_WAITING:
                self._waiting.append((message, topic, asked, until_s))
                return asked
        asked.end(CallNotSent(f"{MAX_WAITING} requests wait already"))
        return asked

    def tick(self) -> None:
        """Send what waits. Call this in the module's thread."""
        while self._waiting:
            with self._lock:
                message, topic, asked, until_s = self._waiting.popleft()
            if time.monotonic() > until_s:
                asked.end(CallNotSent("it has waited too long; give it again"))
                continue
            try:
                self._send(message, asked.end, topic)
            except RobbieError as error:
                asked.end(CallNotSent(str(error)))
