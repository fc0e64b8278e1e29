"""A limit to what strangers can make this process write down."""

import logging
import time
from collections.abc import Callable

BURST = 20
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
        burst: int = BURST,
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
