"""A state machine goes only where its declaration allows."""

from enum import Enum, auto

import pytest

from workers.state_machine import IllegalTransition, StateMachine


class Lamp(Enum):
    OFF = auto()
    ON = auto()
    BROKEN = auto()


TRANSITIONS = {Lamp.OFF: {Lamp.ON}, Lamp.ON: {Lamp.OFF, Lamp.BROKEN}, Lamp.BROKEN: ()}


def machine(times=(0.0,)) -> StateMachine[Lamp]:
    clock = iter(times)
    return StateMachine(Lamp.OFF, TRANSITIONS, lambda: next(clock, times[-1]))


def test_machine_begins_in_its_initial_state():
    assert machine().state is Lamp.OFF


def test_declared_transition_changes_the_state_and_tells_why():
    lamp = machine()
    lamp.go(Lamp.ON, "switched")
    assert (lamp.state, lamp.reason) == (Lamp.ON, "switched")


@pytest.mark.parametrize("target", [Lamp.BROKEN, Lamp.OFF])
def test_undeclared_transition_is_an_error_and_changes_nothing(target):
    lamp = machine()
    with pytest.raises(IllegalTransition, match=r"OFF to .* \(why\) .*: ON"):
        lamp.go(target, "why")
    assert (lamp.state, lamp.reason) == (Lamp.OFF, "start")


def test_final_state_leads_nowhere():
    lamp = machine()
    lamp.go(Lamp.ON, "")
    assert not lamp.is_final
    lamp.go(Lamp.BROKEN, "")
    assert lamp.is_final
    with pytest.raises(IllegalTransition, match="none"):
        lamp.go(Lamp.OFF, "")


def test_time_in_state_starts_again_with_every_transition():
    lamp = machine(times=(10.0, 12.5, 13.0, 13.5))
    assert lamp.time_in_state_s == 2.5
    lamp.go(Lamp.ON, "")
    assert lamp.time_in_state_s == 0.5


def test_state_without_declared_transitions_is_refused():
    with pytest.raises(ValueError, match="BROKEN"):
        StateMachine(Lamp.OFF, {Lamp.OFF: {Lamp.ON}, Lamp.ON: ()}, lambda: 0.0)
