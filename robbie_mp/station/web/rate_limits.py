"""The rate at which strangers can try tokens."""

import time
from collections import OrderedDict
from collections.abc import Callable

from robbie_mp.base.token_bucket import TokenBucket

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
        self._sources: OrderedDict[str, TokenBucket] = OrderedDict()

    def wait_s(self, source: str) -> float:
        """Return the time until an address may try a token; 0: now."""
        bucket = self._sources.get(source)
        return 0.0 if bucket is None else bucket.wait_s

    def note_wrong(self, source: str) -> None:
        """Count a wrong token."""
        new = TokenBucket(TRIES_PER_S, LOGIN_BURST, self._clock)
        self._sources.setdefault(source, new).spend()
        self._sources.move_to_end(source)
        while len(self._sources) > MAX_SOURCES:
            self._sources.popitem(last=False)
