"""Stops children one after another, the last started first."""

from collections.abc import Callable, Sequence

from robbie_mp.supervisor.supervised_child import SupervisedChild, Then


class OrderedStop:
    """Asks each child to end, kills it when its grace is over, and only then turns to the next."""

    def __init__(
        self, children: Sequence[SupervisedChild], then: Then, reason: str, clock: Callable[[], float]
    ):
        """Begin with the last.

        Args:
            children: in the order of their start.
            then: what is to become of them.
            reason: why; see `SupervisedChild.will_stop`.
            clock: a time in s that never goes back.
        """
        for child in children:
            child.will_stop(then, reason)
        self._waiting = [(child, child.incarnation) for child in children]
        self._clock = clock
        self._current: tuple[SupervisedChild, int] | None = None
        self._kill_at_s = 0.0

    def step(self) -> None:
        """Go as far as is possible now."""
        while self._waiting and self._living() is None:
            self._current = self._waiting.pop()
            if child := self._living():
                self._kill_at_s = self._clock() + child.spec.stop_grace_s
                child.terminate()
        child = self._living()
        if child and self._clock() >= self._kill_at_s:
            child.kill(f"did not stop within {child.spec.stop_grace_s:g} s")

    @property
    def is_over(self) -> bool:
        """Whether all have ended."""
        return not self._waiting and self._living() is None

    def next_in_s(self) -> float | None:
        """Return how soon a grace is over, None if no one is waited for."""
        return max(0.0, self._kill_at_s - self._clock()) if self._living() else None

    def _living(self) -> SupervisedChild | None:
        """Return the child that is waited for; a successor of it that was started since is none of ours."""
        if self._current is None:
            return None
        child, incarnation = self._current
        return child if child.pid is not None and child.incarnation == incarnation else None
