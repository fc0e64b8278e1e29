"""A small state machine. You declare states, transitions and time-outs; all other changes are errors.

It needs no module, so workers use it too. This file imports nothing but the base of all errors.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from robbie_mp.base.errors import RobbieError

State = TypeVar("State", bound=Enum)


class IllegalTransition(RobbieError, RuntimeError):
    """A change of state that the machine's declaration does not allow."""


class WrongStateMachine(RobbieError, ValueError):
    """A declaration that leaves out a state, or a time-out that is no declared transition."""


@dataclass(frozen=True)
class TimeOut(Generic[State]):
    """The maximum duration of a state, and the state that follows."""

    after_s: float
    to: State


class StateMachine(Generic[State]):
    """Holds one state of an Enum and measures its duration.

        class Gripper(Enum):
            OPEN = "is open"
            CLOSING = "closes"
            CLOSED = "holds something"

        class Grasp(Module):
            period_s: float = setting(0.1, "time between looks")

            def setup(self) -> None:
                self.machine = StateMachine(
                    Gripper.OPEN,
                    {
                        Gripper.OPEN: {Gripper.CLOSING},
                        Gripper.CLOSING: {Gripper.CLOSED, Gripper.OPEN},
                        Gripper.CLOSED: {Gripper.OPEN},
                    },
                    clock=self.monotonic_s,
                    time_outs={Gripper.CLOSING: TimeOut(after_s=2.0, to=Gripper.OPEN)},
                    on_change=self.show_state,
                )

            def tick(self) -> None:
                self.machine.expire()

    Args:
        initial: The first state.
        transitions: For each state, the states that may follow. A state without any is final.
        clock: Returns the time in s.
        time_outs: For states with a time-out; `expire` applies them.
        on_change: Called with the new state after each transition, as `Module.show_state`.

    Raises:
        WrongStateMachine: A state of the Enum has no declared transitions, or a time-out is not among the
            declared transitions.

    Attributes:
        reason: The reason given with the last transition.
    """

    def __init__(
        self,
        initial: State,
        transitions: Mapping[State, Collection[State]],
        clock: Callable[[], float],
        time_outs: Mapping[State, TimeOut[State]] | None = None,
        on_change: Callable[[State], None] = lambda _state: None,
    ) -> None:
        self._time_outs = dict(time_outs or {})
        _check(type(initial), transitions, self._time_outs)
        self._on_change = on_change
        self._transitions = {state: frozenset(targets) for state, targets in transitions.items()}
        self._clock = clock
        self._state = initial
        self._since_s = clock()
        self.reason = "start"

    @property
    def on_change(self) -> Callable[[State], None]:
        """Return what is called with each new state."""
        return self._on_change

    @property
    def state(self) -> State:
        """Return the current state."""
        return self._state

    @property
    def time_in_state_s(self) -> float:
        """Return how long the machine has been in its state."""
        return self._clock() - self._since_s

    @property
    def is_final(self) -> bool:
        """Return whether no transition leads out of the current state."""
        return not self._transitions[self._state]

    @property
    def is_late(self) -> bool:
        """Return whether the time-out of the current state has passed."""
        time_out = self._time_outs.get(self._state)
        return time_out is not None and self.time_in_state_s >= time_out.after_s

    def expire(self) -> bool:
        """Leave the current state if its time-out has passed; return whether it has."""
        if not self.is_late:
            return False
        time_out = self._time_outs[self._state]
        self.go(time_out.to, f"timed out after {time_out.after_s:g} s")
        return True

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
        self.resume(state, reason)
        self._on_change(state)

    def resume(self, state: State, reason: str) -> None:
        """Go on in a state of which a checkpoint tells; no transition is needed."""
        self._state = state
        self._since_s = self._clock()
        self.reason = reason


def mermaid(
    initial: State,
    transitions: Mapping[State, Collection[State]],
    time_outs: Mapping[State, TimeOut[State]] | None = None,
) -> str:
    """Return a picture of a machine as text for Mermaid (a `stateDiagram-v2`), made of its declaration.

    States whose values are texts are described by them.
    """
    time_outs = time_outs or {}
    _check(type(initial), transitions, time_outs)
    states = list(type(initial))
    lines = ["stateDiagram-v2", f"    [*] --> {initial.name}"]
    lines += [
        f"    {state.name}: {state.name}<br/>{state.value}"
        for state in states
        if isinstance(state.value, str)
    ]
    for state in states:
        for target in (target for target in states if target in transitions[state]):
            time_out = time_outs.get(state)
            after = f": after {time_out.after_s:g} s" if time_out and time_out.to is target else ""
            lines.append(f"    {state.name} --> {target.name}{after}")
        if not transitions[state]:
            lines.append(f"    {state.name} --> [*]")
    return "\n".join(lines) + "\n"


def _check(
    states: type[State],
    transitions: Mapping[State, Collection[State]],
    time_outs: Mapping[State, TimeOut[State]],
) -> None:
    missing = [state.name for state in states if state not in transitions]
    if missing:
        raise WrongStateMachine(
            f"no transitions are declared from {', '.join(missing)}; a final state needs ()"
        )
    for state, time_out in time_outs.items():
        if time_out.to not in transitions[state]:
            raise WrongStateMachine(
                f"the time-out of {state.name} goes to {time_out.to.name}, which is not declared from there"
            )
