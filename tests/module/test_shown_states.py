"""The state of a state machine is shown from the beginning."""

from enum import Enum
from typing import Any

import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.base.state_machine import StateMachine


class Door(Enum):
    OPEN = 1
    CLOSED = 2


TRANSITIONS = {Door.OPEN: {Door.CLOSED}, Door.CLOSED: {Door.OPEN}}


class Doorman(Module):
    goes = False

    def setup(self) -> None:
        self.machine = StateMachine(Door.OPEN, TRANSITIONS, clock=self.monotonic_s, on_change=self.show_state)
        if self.goes:
            self.machine.go(Door.CLOSED, "it is late")


class Silent(Doorman):
    def setup(self) -> None:
        self.machine = StateMachine(Door.OPEN, TRANSITIONS, clock=self.monotonic_s)


class Late(Doorman):
    goes = True


@pytest.mark.parametrize(
    ("module", "states"), [(Doorman, {"": "OPEN"}), (Late, {"": "CLOSED"}), (Silent, {})]
)
def test_first_state_is_shown_if_the_machine_shows_its_states(module: Any, states: dict[str, str]) -> None:
    with ModuleHarness(module) as harness:
        assert harness.module._states == states


def test_status_that_is_no_text_is_shown_as_text() -> None:
    with ModuleHarness(Module) as harness:
        harness.module.status = 3  # type: ignore[assignment]
        harness.module.degraded = LookupError("no map")  # type: ignore[assignment]
        assert (harness.module.status, harness.module.degraded) == ("3", "no map")
