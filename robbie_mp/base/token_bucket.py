"""A token bucket: lets a burst pass, then a fixed average rate."""

import time
from collections.abc import Callable


class TokenBucket:
    """Counts what may pass now. Two threads that call it at the same moment may count one too few.

    Args:
        per_s: average rate.
        burst: number of those that may pass at once.
        clock: tells the time, s.
    """

    def __init__(self, per_s: float, burst: int, clock: Callable[[], float] = time.monotonic):
        self._per_s = per_s
        self._burst = float(burst)
        self._clock = clock
        self._left = self._burst
        self._at_s = clock()

    @property
    def wait_s(self) -> float:
        """Time until the next one may pass; 0: now."""
        return max(0.0, (1.0 - self._filled()) / self._per_s)

    def take(self, most: int = 1) -> int:
        """Return how many of `most` may pass now, and count these."""
        allowed = max(0, min(most, int(self._filled())))
        self._left -= allowed
        return allowed

    def spend(self, count: int = 1) -> None:
        """Count some that pass in any case; the next ones wait longer."""
        self._left = self._filled() - count

    def _filled(self) -> float:
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        return self._left
