"""Limits to strangers: how often they can try tokens, and how much they can make the station log."""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable

LOG_BURST = 20
"""Records that may come at once."""
RECORDS_PER_S = 0.5
"""Records in the long run."""


class LogLimit(logging.Filter):
    """Lets only so many records through; the next one that passes says how many did not.

    Args:
        burst: records that may come at once.
        records_per_s: in the long run.
        clock: tells the time, s.

    Attributes:
        left_out: all that were left out.
    """

    def __init__(
        self,
        burst: int = LOG_BURST,
        records_per_s: float = RECORDS_PER_S,
        clock: Callable[[], float] = time.monotonic,
    ):
        super().__init__()
        self.left_out = 0
        self._burst = burst
        self._records_per_s = records_per_s
        self._clock = clock
        self._allowed = float(burst)
        self._since_s = clock()
        self._untold = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record may pass; two that come at once may both."""
        now_s = self._clock()
        self._allowed = min(self._burst, self._allowed + (now_s - self._since_s) * self._records_per_s)
        self._since_s = now_s
        if self._allowed < 1.0:
            self.left_out += 1
            self._untold += 1
            return False
        self._allowed -= 1.0
        if self._untold:
            record.msg = f"{record.getMessage()} (and {self._untold} more that are not shown)"
            record.args = ()
            self._untold = 0
        return True


def limited(name: str) -> logging.Logger:
    """Return a logger with such a limit; the same name has one limit."""
    found = logging.getLogger(name)
    if not any(isinstance(one, LogLimit) for one in found.filters):
        found.addFilter(LogLimit())
    return found


LOGIN_BURST = 10
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
        left, at_s = self._sources.get(source, (float(LOGIN_BURST), self._clock()))
        return min(float(LOGIN_BURST), left + (self._clock() - at_s) * TRIES_PER_S)
