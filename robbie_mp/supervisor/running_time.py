"""A time for deadlines that no pause of the whole machine can make fire."""

import time
from collections.abc import Callable

LONGEST_STEP_S = 0.25
"""The loop looks at the time more than twice as often, unless this process does not run at all."""


class RunningTime:
    """Time in s that passes only while this process runs.

    When everything is stopped together (a closed lid, a paused virtual machine, a frozen container), everyone
    is late by as much, and nobody is to blame: on waking up, at most `LONGEST_STEP_S` have passed.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        """Start at what the clock says.

        Args:
            clock: a time in s that never goes back.
        """
        self._clock = clock
        self._seen_s = self._time_s = clock()

    def __call__(self) -> float:
        """Return the time; whoever relies on it must ask often."""
        now_s = self._clock()
        self._time_s += min(now_s - self._seen_s, LONGEST_STEP_S)
        self._seen_s = now_s
        return self._time_s
