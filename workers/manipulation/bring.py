"""Brings an object from one place to another: drives, picks up, drives, puts down."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from robbie_mp.state_machine import StateMachine, TimeOut


class BringState(StrEnum):
    """What the robot does."""

    WAIT = "waits for an order"
    FETCH = "drives to where the object is"
    PICK = "picks it up"
    CARRY = "drives to where it should be"
    PUT = "puts it down"


_S = BringState
TRANSITIONS = {
    _S.WAIT: {_S.FETCH},
    _S.FETCH: {_S.PICK, _S.WAIT},
    _S.PICK: {_S.CARRY, _S.FETCH, _S.WAIT},
    _S.CARRY: {_S.PUT, _S.WAIT},
    _S.PUT: {_S.WAIT, _S.CARRY},
}
DRIVES = {_S.FETCH, _S.CARRY}
TRAVEL_S, ARM_S = 90.0, 150.0
TIME_OUTS = {
    _S.FETCH: TimeOut(TRAVEL_S, _S.WAIT),
    _S.CARRY: TimeOut(TRAVEL_S, _S.WAIT),
    _S.PICK: TimeOut(ARM_S, _S.WAIT),
    _S.PUT: TimeOut(ARM_S, _S.WAIT),
}


class BringOrder(NamedTuple):
    """What to bring, from which place, to which."""

    object: str
    source: str
    target: str


@dataclass(frozen=True)
class BringEnd:
    """How an order ended."""

    order: BringOrder
    is_done: bool
    reason: str
    duration_s: float


class BringMission:
    """Carries out one order at a time.

    Its owner drives to `place`, and has the arm do `arm_task`, and says how both end.

    Args:
        clock: returns the time in s.
        on_change: called with each new state.
        max_tries: how often the robot drives to a table again when the arm has failed there.

    Attributes:
        machine: its state.
        order: the present order; None: there is none.
        ends: how the last orders ended, at most 100.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        on_change: Callable[[BringState], None] = lambda _state: None,
        max_tries: int = 3,
    ) -> None:
        self._clock = clock
        self.machine = StateMachine(BringState.WAIT, TRANSITIONS, clock, TIME_OUTS, on_change)
        self.order: BringOrder | None = None
        self.ends: deque[BringEnd] = deque(maxlen=100)
        self._max_tries = max_tries
        self._tries = 0
        self._began_s = clock()

    def begin(self, order: BringOrder) -> None:
        """Begin an order; there must be no other."""
        self.order, self._tries, self._began_s = order, 0, self._clock()
        self.machine.go(BringState.FETCH, f"bring {order.object} to {order.target}")

    @property
    def place(self) -> str | None:
        """Return the name of the place to which the robot should drive now; None: it should stand."""
        if self.order is None or self.machine.state not in DRIVES:
            return None
        return self.order.source if self.machine.state is BringState.FETCH else self.order.target

    @property
    def arm_task(self) -> BringState | None:
        """Return PICK or PUT while the arm should work."""
        return self.machine.state if self.machine.state in (BringState.PICK, BringState.PUT) else None

    def arrived(self) -> None:
        """Take that the robot stands at `place`."""
        if self.machine.state is BringState.FETCH:
            self.machine.go(BringState.PICK, "in front of the table")
        elif self.machine.state is BringState.CARRY:
            self.machine.go(BringState.PUT, "in front of the table")

    def unreachable(self, reason: str) -> None:
        """Take that navigation has given the place up."""
        if self.machine.state in DRIVES:
            self._end(False, reason)

    def arm_done(self) -> None:
        """Take that the arm has done its task."""
        if self.machine.state is BringState.PICK:
            self._tries = 0
            self.machine.go(BringState.CARRY, "holds it")
        elif self.machine.state is BringState.PUT:
            self._end(True, "stands where it should be")

    def arm_failed(self, reason: str) -> None:
        """Take that the arm could not do its task; the robot drives to the table again and repeats it."""
        again = {BringState.PICK: BringState.FETCH, BringState.PUT: BringState.CARRY}
        if self.machine.state not in again:
            return
        self._tries += 1
        if self._tries >= self._max_tries:
            self._end(False, reason)
        else:
            self.machine.go(again[self.machine.state], f"once more: {reason}")

    def step(self) -> None:
        """End an order that takes too long."""
        state = self.machine.state
        if self.machine.expire():
            self._end(False, f"{state.name} took too long")

    def cancel(self, reason: str) -> None:
        """End the order."""
        if self.order is not None:
            self._end(False, reason)

    def _end(self, is_done: bool, reason: str) -> None:
        assert self.order is not None
        self.ends.append(BringEnd(self.order, is_done, reason, self._clock() - self._began_s))
        self.order = None
        if self.machine.state is not BringState.WAIT:
            self.machine.go(BringState.WAIT, reason)

    def memory(self) -> dict[str, Any]:
        """Return what the next process needs to go on, as plain data."""
        return {
            "state": self.machine.state.name,
            "order": None if self.order is None else list(self.order),
            "tries": self._tries,
            "used_s": self._clock() - self._began_s,
            "ends": [[list(one.order), one.is_done, one.reason, one.duration_s] for one in self.ends],
        }

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` returned: with the same step of the same order."""
        self._tries, self._began_s = memory["tries"], self._clock() - memory["used_s"]
        for order, is_done, reason, duration_s in memory["ends"]:
            self.ends.append(BringEnd(BringOrder(*order), is_done, reason, duration_s))
        if memory["order"] is None:
            return
        self.order = BringOrder(*memory["order"])
        for state in (BringState.FETCH, BringState.PICK, BringState.CARRY, BringState.PUT):
            self.machine.go(state, "after a restart")
            if state.name == memory["state"]:
                break
