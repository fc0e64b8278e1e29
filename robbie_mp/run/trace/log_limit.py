"""A limit for the records that a logger writes about what others do, so that nobody can flood the trace."""

import logging
import time
from collections.abc import Callable

from robbie_mp.base.token_bucket import TokenBucket

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
        self._bucket = TokenBucket(records_per_s, burst, clock)
        self._untold = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record may pass. Records from two threads at the same moment may both pass."""
        if not self._bucket.take():
            self.left_out += 1
            self._untold += 1
            return False
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
