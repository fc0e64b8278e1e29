"""A state machine makes only declared transitions."""

from collections.abc import Sequence
from enum import Enum, auto

import pytest
from strenum import StrEnum

from robbie_mp.base.state_machine import IllegalTransition, StateMachine, TimeOut, mermaid


class Lamp(Enum):
    OFF = auto()
    ON = auto()
    BROKEN = auto()


class Trip(StrEnum):
    HOME = "is home"


TRANSITIONS = {Lamp.OFF: {Lamp.ON}, Lamp.ON: {Lamp.OFF, Lamp.BROKEN}, Lamp.BROKEN: ()}


def machine(times: Sequence[float] = (0.0,)) -> StateMachine[Lamp]:
    clock = iter(times)
    return StateMachine(Lamp.OFF, TRANSITIONS, lambda: next(clock, times[-1]))


def test_machine_starts_in_its_initial_state() -> None:
    assert machine().state is Lamp.OFF


def test_declared_transition_changes_the_state_and_stores_the_reason() -> None:
    lamp = machine()
    lamp.go(Lamp.ON, "switched")
    assert (lamp.state, lamp.reason) == (Lamp.ON, "switched")


@pytest.mark.parametrize("target", [Lamp.BROKEN, Lamp.OFF])
def test_undeclared_transition_is_an_error_and_changes_nothing(target: Lamp) -> None:
    lamp = machine()
    with pytest.raises(IllegalTransition, match=r"OFF to .* \(why\) .*: ON"):
        lamp.go(target, "why")
    assert (lamp.state, lamp.reason) == (Lamp.OFF, "start")


def test_final_state_has_no_transitions() -> None:
    lamp = machine()
    lamp.go(Lamp.ON, "")
    was_final = lamp.is_final
    lamp.go(Lamp.BROKEN, "")
    assert (was_final, lamp.is_final) == (False, True)
    with pytest.raises(IllegalTransition, match="none"):
        lamp.go(Lamp.OFF, "")


def test_time_in_state_starts_again_with_every_transition() -> None:
    lamp = machine(times=(10.0, 12.5, 13.0, 13.5))
    assert lamp.time_in_state_s == 2.5
    lamp.go(Lamp.ON, "")
    assert lamp.time_in_state_s == 0.5


def test_state_without_declared_transitions_is_refused() -> None:
    with pytest.raises(ValueError, match="BROKEN"):
        StateMachine(Lamp.OFF, {Lamp.OFF: {Lamp.ON}, Lamp.ON: ()}, lambda: 0.0)


def test_state_that_lasts_too_long_changes_to_that_of_its_time_out() -> None:
    times = [0.0]
    shown: list[Lamp] = []
    lamp = StateMachine(
        Lamp.OFF, TRANSITIONS, lambda: times[0], {Lamp.ON: TimeOut(5.0, Lamp.BROKEN)}, shown.append
    )
    times[0] = 100.0
    assert not lamp.expire()  # OFF has none
    lamp.go(Lamp.ON, "switched")
    times[0] = 104.9
    assert not lamp.expire()
    times[0] = 105.0
    assert lamp.expire()
    assert (lamp.state, lamp.reason) == (Lamp.BROKEN, "timed out after 5 s")
    assert shown == [Lamp.ON, Lamp.BROKEN]


def test_time_out_along_an_undeclared_transition_is_refused() -> None:
    with pytest.raises(ValueError, match="time-out of OFF goes to BROKEN"):
        StateMachine(Lamp.OFF, TRANSITIONS, lambda: 0.0, {Lamp.OFF: TimeOut(1.0, Lamp.BROKEN)})


def test_diagram_shows_every_state_transition_and_time_out() -> None:
    assert mermaid(Lamp.OFF, TRANSITIONS, {Lamp.ON: TimeOut(5.0, Lamp.BROKEN)}).splitlines() == [
        "stateDiagram-v2",
        "    [*] --> OFF",
        "    OFF --> ON",
        "    ON --> OFF",
        "    ON --> BROKEN: after 5 s",
        "    BROKEN --> [*]",
    ]


def test_diagram_describes_states_whose_values_are_texts() -> None:
    assert "    HOME: HOME<br/>is home" in mermaid(Trip.HOME, {Trip.HOME: ()})
