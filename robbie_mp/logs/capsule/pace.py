"""Lets the steps of a replay begin when they did then, so that a module's own threads get as far."""

from time import monotonic, sleep  # the machine's, not those of then

from robbie_mp.logs.capsule.read import Capsule, Step

MOST_S = 60.0
"""Only the last steps are paced, for this long."""
MOST_GAP_S = 2.0
"""A longer pause between two steps is shortened: a step that does not begin seems to hang."""
LAST_S = 0.1
"""The last step waits so much longer, in which a slower thread comes up."""


class Pace:
    """The times of a capsule's steps.

    Args:
        capsule: the capsule.
    """

    def __init__(self, capsule: Capsule):
        self._last = len(capsule.steps) - 1
        self._from_ns = max(_time_ns(step) for step in capsule.steps) - MOST_S * 1e9
        self._newest_ns = capsule.manifest.start.monotonic_ns if capsule.base is None else 0
        self._due_s: float | None = None

    def wait_for(self, number: int, step: Step) -> None:
        """Wait until a step begins."""
        if self._due_s is None:
            self._due_s = monotonic()
        time_ns = _time_ns(step)
        if self._newest_ns > self._from_ns and time_ns > self._newest_ns:
            self._due_s += min((time_ns - self._newest_ns) / 1e9, MOST_GAP_S)
        self._newest_ns = max(self._newest_ns, time_ns)
        extra_s = LAST_S if number == self._last else 0.0
        sleep(max(0.0, self._due_s + extra_s - monotonic()))


def _time_ns(step: Step) -> int:
    return step.event.time_ns if step.event is not None else 0
