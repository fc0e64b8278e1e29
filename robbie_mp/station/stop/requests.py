"""Presses of the emergency stop: the station sends each to the base until the base has confirmed it."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

from strenum import StrEnum

REQUEST_TOPIC = "emergency_stop"
STATE_TOPIC = "emergency_stop_state"
REPEAT_S = 0.2
"""A stop that the base has not confirmed is sent again after this time."""
MIN_INTERVAL_S = 0.05
"""Minimum time between two stops, even if many pages press."""
IN_FLIGHT_S = 0.5
"""If the base reports STOPPED this soon after a release, it may not have received the release yet."""
MAX_PRESSES = 256
"""Maximum number of remembered presses, waiting and settled."""
MAX_NAME_LENGTH = 64
SOON_S = 0.7
"""A stop that is confirmed within this is not worth a word."""
STALE_S = 1.0
"""A base tells its state several times a second."""


class PressState(StrEnum):
    """The state of a press."""

    PENDING = "pending"
    """The base has not confirmed it yet."""
    CONFIRMED = "confirmed"
    """The base stands."""
    WITHDRAWN = "withdrawn"
    """An operator released the stop before the base confirmed it."""


class StopRequests:
    """Sends stops and releases to the base, and tracks the state of each press.

    A press has a name, so that a page can repeat it on every connection until it knows that the press is
    settled. A settled press never stops the robot again. Any thread may call any method.

    Args:
        send: sends a stop (True) or a release (False) to the base; False if that is not possible now.
        now_s: the machine's monotonic time.
    """

    def __init__(self, send: Callable[[bool], bool], now_s: Callable[[], float] = time.monotonic):
        self._send = send
        self._now_s = now_s
        self._lock = threading.Lock()
        self._pending: OrderedDict[str, float | None] = OrderedDict()
        """When each press was first sent to the base; None: not yet."""
        self._settled: OrderedDict[str, PressState] = OrderedDict()
        self._last_sent_s = self._released_s = -float("inf")
        self._waits_since_s = 0.0
        self._listeners: tuple[Callable[[], None], ...] = ()

    @property
    def waits_s(self) -> float | None:
        """Age of the oldest stop that the base has not confirmed; None if it has confirmed all."""
        with self._lock:
            return self._now_s() - self._waits_since_s if self._pending else None

    def fate(self, name: str) -> PressState | None:
        """Return the state of a press; None if it is unknown."""
        with self._lock:
            return PressState.PENDING if name in self._pending else self._settled.get(name)

    def press(self, name: str) -> None:
        """Stop the robot. Nothing happens if this press is known already."""
        with self._lock:
            if name in self._pending or name in self._settled:
                return
            if not self._pending:
                self._waits_since_s = self._now_s()
            self._pending[name] = None
            _shorten(self._pending)
            self._send_stop()
        self.tell()

    def release(self) -> bool:
        """Release the stop, and withdraw all waiting presses. Return False if the release was not sent."""
        with self._lock:
            is_sent = self._send(False)
            if is_sent:
                self._released_s = self._now_s()
                self._settle(list(self._pending), PressState.WITHDRAWN)
        self.tell()
        return is_sent

    def see(self, *, engaged: bool, published_s: float) -> None:
        """Process the base's state and the time when the base published it."""
        with self._lock:
            if not self._pending or not engaged or published_s < self._released_s + IN_FLIGHT_S:
                return
            heard = [
                name for name, sent_s in self._pending.items() if sent_s is not None and sent_s < published_s
            ]
            self._settle(heard, PressState.CONFIRMED)
        if heard:
            self.tell()

    def repeat(self) -> None:
        """Send unconfirmed stops again. Call this often."""
        with self._lock:
            if not self._pending:
                return
            is_new = None in self._pending.values()
            if is_new or self._now_s() - self._last_sent_s >= REPEAT_S:
                self._send_stop()

    def listen(self, listener: Callable[[], None]) -> None:
        """Call a function, in any thread, whenever the state of a press changes."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def ignore(self, listener: Callable[[], None]) -> None:
        """Stop calling a function."""
        with self._lock:
            self._listeners = tuple(one for one in self._listeners if one is not listener)

    def _send_stop(self) -> None:
        """Send one stop for all waiting presses, unless the last one was just sent."""
        now_s = self._now_s()
        if now_s - self._last_sent_s < MIN_INTERVAL_S or not self._send(True):
            return
        self._last_sent_s = now_s
        for name, sent_s in self._pending.items():
            if sent_s is None:
                self._pending[name] = now_s

    def _settle(self, names: list[str], fate: PressState) -> None:
        for name in names:
            del self._pending[name]
            self._settled[name] = fate
        _shorten(self._settled)

    def tell(self) -> None:
        """Call all listeners."""
        for listener in self._listeners:
            listener()


def state_text(waits_s: float | None, is_engaged: bool | None, silent_s: float | None, why: str = "") -> str:
    """Return the state of a robot's emergency stop for a page with several robots.

    Args:
        waits_s: how long a stop has not been confirmed; None: there is none.
        is_engaged: what the base said last; None: nothing yet.
        silent_s: how long ago that was.
        why: why a stop may not be confirmed, if that is known.
    """
    if waits_s is not None:
        return "stopping …" if waits_s < SOON_S else f"NOT CONFIRMED for {waits_s:.0f} s{why}"
    if is_engaged is None or silent_s is None:
        return "base silent"
    text = "STOPPED" if is_engaged else "ready"
    return text if silent_s <= STALE_S else f"base silent for {silent_s:.0f} s; before: {text}"


def _shorten(presses: OrderedDict[str, float | None] | OrderedDict[str, PressState]) -> None:
    """Forget the oldest presses. A page that still waits for such a press repeats it."""
    while len(presses) > MAX_PRESSES:
        presses.popitem(last=False)
