"""Limits for strangers: the rate at which they can try tokens, and the amount that the station logs."""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable

LOG_BURST = 20
"""Number of records that may be logged at once."""
RECORDS_PER_S = 0.5
"""Average rate of records."""


class LogLimit(logging.Filter):
    """Passes log records at a limited rate. After a gap, the next record says how many were omitted.

    Args:
        burst: number of records that may be logged at once.
        records_per_s: average rate of records.
        clock: returns the time, s.

    Attributes:
        left_out: number of omitted records.
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
    """Return the logger with a name, with a LogLimit."""
    found = logging.getLogger(name)
    if not any(isinstance(one, LogLimit) for one in found.filters):
        found.addFilter(LogLimit())
    return found


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
