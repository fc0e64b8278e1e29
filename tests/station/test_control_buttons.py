"""The strip says who controls the robot, and operators order it to go on or to hold."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp.messages import ControlState, OperatorRequest, SetControl
from robbie_mp.station.page import control_buttons
from robbie_mp.station.page.control_buttons import ControlButtons
from robbie_mp.station.page.state_item import GOOD, WARNING, StateItem
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.web.access import Role


@pytest.fixture
def state() -> Latest[ControlState]:
    return Latest[ControlState]()


@pytest.fixture
def control(state: Latest[ControlState]) -> ControlButtons:
    messages: Any = SimpleNamespace(newest=lambda *_: state)
    return ControlButtons(messages, Mock(is_elsewhere=False))


def test_strip_says_who_controls_the_robot_and_why(
    control: ControlButtons, state: Latest[ControlState]
) -> None:
    before = control.item
    assert before is None
    state.put(ControlState(mode=ControlState.AUTO, reason="the run has started"))
    auto = control.item or StateItem("", "", "")
    assert (auto.text, auto.look) == ("AUTO", GOOD)
    state.put(ControlState(mode=ControlState.HOLD, who="operator", reason="the operator has let go"))
    held = control.item or StateItem("", "", "")
    assert (held.text, held.look) == ("HOLD: the operator has let go", WARNING)
    assert held.detail == "HOLD: the operator has let go, by operator"


def test_only_operators_order_and_only_what_changes_something(
    control: ControlButtons, state: Latest[ControlState], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: dict[str, Mock] = {}
    monkeypatch.setattr(control_buttons, "_button", lambda text, _icon, _name: made.setdefault(text, Mock()))
    page = Mock(role=Role.OBSERVER)
    control.build(page)
    control.add_keys(page)
    assert not made
    page.add_key.assert_not_called()
    page.role = Role.OPERATOR
    control.build(page)
    control.add_keys(page)
    ((_, update), _) = page.always.call_args
    shown: dict[int, Any] = {}
    for mode in (ControlState.AUTO, ControlState.MANUAL, ControlState.HOLD):
        state.put(ControlState(mode=mode))
        update()
        shown[mode] = {text for text, one in made.items() if one.set_visibility.call_args.args[0]}
    assert shown == {0: {"Hold"}, 1: {"Go on", "Hold"}, 2: {"Go on"}}
    keys = {call.args[0]: call.args[2] for call in page.add_key.call_args_list}
    keys["g"]()
    made["Hold"].on_click.call_args.args[0]()
    asked = [call.args[0] for call in page.ask.call_args_list]
    assert [(type(one), one.mode) for one in asked] == [(SetControl, 0), (SetControl, 2)]


def test_orders_to_a_robot_elsewhere_are_wishes_that_pass_the_link(state: Latest[ControlState]) -> None:
    command, page = Mock(is_elsewhere=True), Mock()
    messages: Any = SimpleNamespace(newest=lambda *_: state)
    ControlButtons(messages, command).order(page, ControlState.AUTO)
    page.may.return_value = False
    ControlButtons(messages, command).order(page, ControlState.HOLD)
    command.ask.assert_called_once_with(OperatorRequest.GO_ON)
    page.ask.assert_not_called()
