"""Whose commands joints follow, and whose only keep them where they are, so that their load does not fall."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

LET_GO_S = 0.5
"""A sender has let go when no command of it has come for this time."""
STANDS_PER_S = 0.02
"""A joint that is slower stands; it may press, as a gripper that holds something."""
SETTLES_S = 0.1
"""A joint that still does not move this long after it got its goal presses."""
NEAR = 0.1
"""Commands this near to where the joints were stopped, in rad or m, begin there: their sender knows of it."""


class JointSource(NamedTuple):
    """Who commands: a link may pass on commands of modules and of operators."""

    sender: str
    by_hand: bool


class JointControl:
    """Decides what commands lead to: one source at a time moves the joints, and an operator takes over.

    During an emergency stop nobody moves the joints, and while the robot holds, no module does: commands keep
    them where they are. The same holds after an operator has moved them. A source that was sending at that
    time must stop sending first, or start from where the joints are.

    Args:
        clock: returns the time in s; it never goes back.

    Attributes:
        kept: positions that the joints keep, by name; empty if nobody was stopped yet.
        until_s: when the last command expires.
        is_stopped: whether the emergency stop is engaged.
        holds: whether the robot is not in AUTO.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._at: dict[str, tuple[float, float]] = {}
        self._goals: dict[str, float] = {}
        self._wanted_s: dict[str, float] = {}
        """Since when each joint has had its goal."""
        self._direction: dict[str, float] = {}
        self._direction_until_s = -math.inf
        self._sent_s: dict[JointSource, float] = {}
        self._must_let_go: set[JointSource] = set()
        self._mover: JointSource | None = None
        self.kept: dict[str, float] = {}
        self.until_s = -math.inf
        self.is_stopped = self.holds = False

    def see(self, at: Mapping[str, tuple[float, float]]) -> None:
        """Take the position and the speed of each joint, and drop a direction whose time is over."""
        self._at = dict(at)
        if (self.is_stopped or self.holds) and not self.kept:  # since before it was known where they are
            self._end(())
        if self._clock() >= self._direction_until_s:
            self._direction = {}  # what was ordered before a stop must not move a joint after it

    def stop(self) -> None:
        """Keep the joints where they are and follow no source."""
        self.is_stopped = True
        self._end(self._sent_s)

    def release(self) -> None:
        """End `stop`."""
        self.is_stopped = False

    def hold(self, *, hands_too: bool) -> bool:
        """Let no module move the joints; return whether they must stop now.

        Args:
            hands_too: operators, too, must let go first.
        """
        goes_on = not hands_too and (self.holds or self._is_moved_by_hand)
        self.holds = True
        if not goes_on:
            self._end(source for source in self._sent_s if hands_too or not source.by_hand)
        return not goes_on

    def go_on(self) -> None:
        """End `hold`."""
        self.holds = False

    def followed(
        self, source: JointSource, wanted: Mapping[str, float], sent_s: float, until_s: float
    ) -> dict[str, float] | None:
        """Return the positions that a command leads to; None if another source moves the joints.

        Args:
            source: the sender of the command.
            wanted: positions, by the joints' names.
            sent_s: when it was sent, by the clock.
            until_s: when it expires.
        """
        self._note(source, wanted, sent_s)
        if self._is_taken(source, sent_s):
            return None
        self.until_s = until_s
        if source in self._must_let_go:
            return {name: self.kept[name] for name in wanted if name in self.kept}
        if source.by_hand and source != self._mover:
            self._must_let_go |= self._sent_s.keys() - {source}
        self._mover = source
        self._want(wanted)
        return dict(wanted)

    def direct(self, wanted: Mapping[str, float], until_s: float) -> None:
        """Take positions that joints keep once they are there; the newest count.

        Args:
            wanted: positions, by the joints' names.
            until_s: by when modules must be allowed to move the joints, by the clock.
        """
        self._direction, self._direction_until_s = dict(wanted), until_s

    def due_direction(self) -> dict[str, float]:
        """Return the positions of `direct`, once, as soon as modules may move the joints; before, nothing."""
        if self.is_stopped or self.holds or self._is_moved_by_hand or not self._direction:
            return {}
        due, self._direction = self._direction, {}
        self._mover, self.until_s = None, math.inf
        self._want(due)
        return due

    @property
    def mover(self) -> str:
        """Who moves the joints, in plain words; '' if nobody does."""
        if self._mover is None:
            return ""
        return f"{self._mover.sender} (by hand)" if self._mover.by_hand else self._mover.sender

    @property
    def _is_moved_by_hand(self) -> bool:
        return self._mover is not None and self._mover.by_hand and self._clock() < self.until_s

    def _want(self, goals: Mapping[str, float]) -> None:
        for name, goal in goals.items():
            if self._goals.get(name) != goal:
                self._wanted_s[name] = self._clock()
        self._goals |= goals

    def _note(self, source: JointSource, wanted: Mapping[str, float], sent_s: float) -> None:
        """Note whether a source may move the joints, and when it has sent something."""
        if self._mover is not None and self._mover.by_hand and not self._is_moved_by_hand:
            self._end(self._sent_s.keys() - {self._mover})  # the operator has let go
        silent_s = sent_s - self._sent_s.get(source, -math.inf)
        if self.is_stopped or (self.holds and not source.by_hand):
            self._must_let_go.add(source)
        elif silent_s >= LET_GO_S or (self._is_near(wanted) and not self._is_moved_by_hand):
            self._must_let_go.discard(source)
        self._sent_s = {**self._recent(sent_s), source: sent_s}
        self._must_let_go &= self._sent_s.keys()

    def _is_taken(self, source: JointSource, sent_s: float) -> bool:
        """Return whether another source moves the joints, and this one does not take over."""
        if self._mover in (None, source) or self._mover in self._must_let_go:
            return False
        if source.by_hand and source not in self._must_let_go:
            return False
        return self._is_moved_by_hand or sent_s - self._sent_s.get(self._mover, -math.inf) < LET_GO_S

    def _end(self, sources: Iterable[JointSource]) -> None:
        """Let nobody of these move the joints before letting go; keep the joints where they are."""
        self._must_let_go |= set(sources)
        self._mover = None
        self.kept = {name: self._kept(name, *seen) for name, seen in self._at.items()}

    def _recent(self, now_s: float) -> dict[JointSource, float]:
        return {source: at_s for source, at_s in self._sent_s.items() if now_s - at_s < LET_GO_S}

    def _is_near(self, wanted: Mapping[str, float]) -> bool:
        return all(abs(goal - self.kept.get(name, goal)) <= NEAR for name, goal in wanted.items())

    def _kept(self, name: str, position: float, speed: float) -> float:
        """Return the goal of a joint that stands and may press, or where it is."""
        now_s = self._clock()
        is_settled = now_s - self._wanted_s.get(name, -math.inf) >= SETTLES_S
        presses = now_s < self.until_s and is_settled and abs(speed) < STANDS_PER_S
        return self._goals.get(name, position) if presses else position
