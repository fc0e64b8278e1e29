"""The emergency stop of joints: they stay where they are, and their load does not fall."""

import math
from collections.abc import Callable, Mapping

LET_GO_S = 0.5
"""A sender has let go when no command of it has come for this time."""
STANDS_PER_S = 0.02
"""A joint that is slower stands; it may press, as a gripper that holds something."""
NEAR = 0.1
"""Commands this near to where the joints were stopped, in rad or m, begin there: their sender knows of it."""


class JointStop:
    """Changes the commands of joints during an emergency stop, and after it those of senders who held on.

    Args:
        clock: returns the time in s; it never goes back.

    Attributes:
        kept: positions that the joints keep, by name; empty if there is no stop and nobody has held on.
        is_engaged: whether the emergency stop is engaged.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._at: dict[str, tuple[float, float]] = {}
        self._goals: dict[str, float] = {}
        self._sent_s: dict[str, float] = {}
        self._must_let_go: set[str] = set()
        self.kept: dict[str, float] = {}
        self.is_engaged = False

    def see(self, at: Mapping[str, tuple[float, float]]) -> None:
        """Take the position and the speed of each joint."""
        self._at = dict(at)

    def engage(self) -> None:
        """Keep the joints where they are from now on."""
        self.is_engaged = True
        self._must_let_go |= self._sent_s.keys()
        self.kept = {name: self._kept(name, *seen) for name, seen in self._at.items()}

    def release(self) -> None:
        """Let the joints follow new commands."""
        self.is_engaged = False

    def followed(self, sender: str, wanted: Mapping[str, float], sent_s: float) -> dict[str, float]:
        """Return the positions that a command leads to.

        Args:
            sender: who has sent it.
            wanted: positions, by the joints' names.
            sent_s: when it was sent, by the clock.
        """
        silent_s = sent_s - self._sent_s.get(sender, -math.inf)
        if not self.is_engaged and (silent_s >= LET_GO_S or self._is_near(wanted)):
            self._must_let_go.discard(sender)
        elif self.is_engaged:
            self._must_let_go.add(sender)
        self._sent_s = {**self._recent(sent_s), sender: sent_s}
        if sender in self._must_let_go:
            return {name: self.kept[name] for name in wanted if name in self.kept}
        self._goals |= wanted
        return dict(wanted)

    def _recent(self, now_s: float) -> dict[str, float]:
        return {
            who: at_s
            for who, at_s in self._sent_s.items()
            if now_s - at_s < LET_GO_S or who in self._must_let_go
        }

    def _is_near(self, wanted: Mapping[str, float]) -> bool:
        return all(abs(goal - self.kept.get(name, goal)) <= NEAR for name, goal in wanted.items())

    def _kept(self, name: str, position: float, speed: float) -> float:
        return self._goals.get(name, position) if abs(speed) < STANDS_PER_S else position
