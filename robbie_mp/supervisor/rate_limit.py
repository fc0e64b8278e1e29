"""Bounds how many lines a second pass."""

import time
from collections.abc import Callable


class RateLimit:
    """Lets a burst pass, and then as many lines a second as are allowed (a token bucket)."""

    def __init__(self, lines_per_s: float, burst_lines: int, clock: Callable[[], float] = time.monotonic):
        self._lines_per_s = lines_per_s
        self._burst_lines = float(burst_lines)
        self._clock = clock
        self._allowance = self._burst_lines
        self._updated_s = clock()

    def take(self, count: int) -> int:
        """Return how many of so many lines may pass."""
        now_s = self._clock()
        gained = (now_s - self._updated_s) * self._lines_per_s
        self._updated_s = now_s
        self._allowance = min(self._burst_lines, self._allowance + gained)
        allowed = min(count, int(self._allowance))
        self._allowance -= allowed
        return allowed
