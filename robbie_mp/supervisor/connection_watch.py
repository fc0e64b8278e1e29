"""Warns of subscriptions that no module publishes for."""

import time
from collections.abc import Callable

from robbie_mp.observe import RunObserver
from robbie_mp.trace.kinds import Kind

CHECK_PERIOD_S = 2.0


class ConnectionWatch:
    """Says once for each subscription that it is unconnected.

    A check costs well below a millisecond for each module, and no other process.

    Args:
        observer: reads the run.
        say: writes an entry of the supervisor into the trace.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        observer: RunObserver,
        say: Callable[[Kind, str], None],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._observer = observer
        self._say = say
        self._clock = clock
        self._next_s = 0.0
        self._suspected: set[tuple[str, str, int, str]] = set()
        self._told: set[tuple[str, str, int, str]] = set()

    def turn(self) -> None:
        """Check, if it is time for that."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + CHECK_PERIOD_S
        found = {
            (module, one.type_name, one.version, one.topic): f"{module} {one}"
            for module, alone in self._observer.unconnected().items()
            for one in alone
        }
        # A module may subscribe late: only what was found twice counts.
        for key in [key for key in found if key in self._suspected and key not in self._told]:
            self._told.add(key)
            self._say(Kind.WARNING, found[key])
        self._suspected = set(found)
