"""A small state machine: states and allowed transitions are declared, everything else is an error."""

from collections.abc import Callable, Collection, Mapping
from enum import Enum
from typing import Generic, TypeVar

State = TypeVar("State", bound=Enum)


class IllegalTransition(RuntimeError):
    """A change of state that the machine's declaration does not allow."""


class StateMachine(Generic[State]):
    """Holds one state of an Enum and knows for how long.

    Args:
        initial: The first state.
        transitions: From each state, where it may go; a state that may go nowhere is final.
        clock: Returns the time in s.

    Raises:
        ValueError: The declaration leaves a state of the Enum out.

    Attributes:
        reason: Why the machine is in its state, as the last transition told.
    """

    def __init__(
        self, initial: State, transitions: Mapping[State, Collection[State]], clock: Callable[[], float]
    ) -> None:
        missing = [state.name for state in type(initial) if state not in transitions]
        if missing:
            raise ValueError(f"no transitions are declared from {', '.join(missing)}; a final state needs ()")
        self._transitions = {state: frozenset(targets) for state, targets in transitions.items()}
        self._clock = clock
        self._state = initial
        self._since_s = clock()
        self.reason = "start"

    @property
    def state(self) -> State:
        """Return the present state."""
        return self._state

    @property
    def time_in_state_s(self) -> float:
        """Return how long the machine has been in its state."""
        return self._clock() - self._since_s

    @property
    def is_final(self) -> bool:
        """Say whether no transition leads out of the present state."""
        return not self._transitions[self._state]

    def go(self, state: State, reason: str) -> None:
        """Change the state.

        Raises:
            IllegalTransition: The declaration does not allow it; the state stays.
        """
        if state not in self._transitions[self._state]:
            allowed = ", ".join(sorted(target.name for target in self._transitions[self._state])) or "none"
            raise IllegalTransition(
                f"{self._state.name} to {state.name} ({reason}) is not declared; declared are: {allowed}"
            )
        self._state = state
        self._since_s = self._clock()
        self.reason = reason
