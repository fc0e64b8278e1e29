"""Stops children one after another, the last started first."""

from collections.abc import Callable, Sequence

from robbie_mp.supervisor.supervised_child import SupervisedChild


class OrderedStop:
    """Asks each child to end, kills it when its grace is over, and only then turns to the next."""

    def __init__(self, children: Sequence[SupervisedChild], clock: Callable[[], float]):
        """Begin with the last.

        Args:
            children: in the order of their start.
            clock: a time in s that never goes back.
        """
        self._waiting = list(children)
        self._clock = clock
        self._current: SupervisedChild | None = None
        self._kill_at_s = 0.0

    def step(self) -> None:
        """Go as far as is possible now."""
        while self._waiting and not self._has_process(self._current):
            self._current = self._waiting.pop()
            self._kill_at_s = self._clock() + self._current.spec.stop_grace_s
            self._current.terminate()
        if self._current and self._clock() >= self._kill_at_s:
            self._current.kill(f"did not stop within {self._current.spec.stop_grace_s:g} s")

    def next_in_s(self) -> float | None:
        """Return how soon a grace is over, None if no one is waited for."""
        if not self._has_process(self._current):
            return None
        return max(0.0, self._kill_at_s - self._clock())

    @staticmethod
    def _has_process(child: SupervisedChild | None) -> bool:
        return child is not None and child.pid is not None
