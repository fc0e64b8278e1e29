"""The rate at which strangers can try tokens."""

import time
from collections import OrderedDict
from collections.abc import Callable

LOGIN_BURST = 10
"""Number of wrong tokens that an address may try in a row."""
TRIES_PER_S = 0.2
"""Average rate of wrong tokens."""
MAX_SOURCES = 1024
"""Maximum number of remembered addresses. The least recent one is forgotten first."""


class LoginLimit:
    """Counts the wrong tokens of each address.

    Args:
        clock: tells the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._sources: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Remaining tries of each address, and the time of that count."""

    def wait_s(self, source: str) -> float:
        """Return the time until an address may try a token; 0: now."""
        return max(0.0, (1.0 - self._left(source)) / TRIES_PER_S)

    def note_wrong(self, source: str) -> None:
        """Count a wrong token."""
        self._sources[source] = (self._left(source) - 1.0, self._clock())
        self._sources.move_to_end(source)
        while len(self._sources) > MAX_SOURCES:
            self._sources.popitem(last=False)

    def _left(self, source: str) -> float:
        left, at_s = self._sources.get(source, (float(LOGIN_BURST), self._clock()))
        return min(float(LOGIN_BURST), left + (self._clock() - at_s) * TRIES_PER_S)
