"""A limit to how often tokens can be tried."""

import time
from collections import OrderedDict
from collections.abc import Callable

BURST = 10
"""Wrong tokens that an address may try at once."""
TRIES_PER_S = 0.2
"""In the long run."""
MAX_SOURCES = 1024
"""Addresses that are remembered; the one that tried least lately is forgotten."""


class LoginLimit:
    """Knows how many wrong tokens came from where.

    Args:
        clock: tells the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._sources: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Tries left, and when there were so many."""

    def wait_s(self, source: str) -> float:
        """Return how long an address has to wait until it may try a token; 0: it may now."""
        return max(0.0, (1.0 - self._left(source)) / TRIES_PER_S)

    def note_wrong(self, source: str) -> None:
        """Count a wrong token."""
        self._sources[source] = (self._left(source) - 1.0, self._clock())
        self._sources.move_to_end(source)
        while len(self._sources) > MAX_SOURCES:
            self._sources.popitem(last=False)

    def _left(self, source: str) -> float:
        left, at_s = self._sources.get(source, (float(BURST), self._clock()))
        return min(float(BURST), left + (self._clock() - at_s) * TRIES_PER_S)
