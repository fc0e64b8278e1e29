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
    """Passes log records at a limited rate; the next one that passes says how many were left out.

    Args:
        burst: records that may come at once.
        records_per_s: in the long run.
        clock: tells the time, s.

    Attributes:
        left_out: number of records that were left out.
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
        """Return whether a record may pass. Records from two threads at the same moment may both pass."""
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
    """Return the logger of a name, with a LogLimit."""
    found = logging.getLogger(name)
    if not any(isinstance(one, LogLimit) for one in found.filters):
        found.addFilter(LogLimit())
    return found


LOGIN_BURST = 10
"""Wrong tokens that an address may try in a row."""
TRIES_PER_S = 0.2
"""In the long run."""
MAX_SOURCES = 1024
"""Addresses that are remembered; the least recent one is forgotten first."""


class LoginLimit:
    """Counts the wrong tokens of each address.

    Args:
        clock: tells the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._sources: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Tries left, and the time at which that was so."""

    def wait_s(self, source: str) -> float:
        """Return the time until an address may try a token; 0: it may now."""
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
