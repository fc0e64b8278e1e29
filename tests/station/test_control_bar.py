"""The bar says who controls the robot, and operators order it to go on or to hold."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp.messages import ControlState, OperatorRequest, SetControl
from robbie_mp.station.driving.seat import DriversSeat
from robbie_mp.station.page.control_bar import ControlBar
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.web.access import Role


@pytest.fixture
def state() -> Latest[ControlState]:
    return Latest[ControlState]()


def bar_of(state: Latest[ControlState]) -> ControlBar:
    """The bar of a station without a page in the driver's seat."""
    messages: Any = SimpleNamespace(newest=lambda *_: state)
    robot = Mock(is_elsewhere=False, other="", rival="")
    return ControlBar(messages, Mock(seat=DriversSeat(), command=robot))


def page_with(key: str = "mine", role: Role = Role.OPERATOR) -> Mock:
    driver = Mock(delay="", refused=0, stale=0, is_other_driving=False)
    return Mock(key=key, role=role, driver=driver if role is Role.OPERATOR else None)


def test_bar_says_who_drives_and_why(state: Latest[ControlState]) -> None:
    bar, page = bar_of(state), page_with()
    assert (bar.shown(page)["mode"], bar.shown(page)["who"]) == ("", "nobody drives")
    state.put(ControlState(mode=ControlState.AUTO, reason="the run has started"))
    bar._operators.seat.take("mine")
    auto = bar.shown(page)
    assert (auto["mode"], auto["who"], auto["orders"]) == ("AUTO", "modules drive", ["HOLD"])
    state.put(ControlState(mode=ControlState.MANUAL, who="operator", reason="an operator drives"))
    assert (bar.shown(page)["who"], bar.shown(page_with("other"))["who"]) == (
        "you drive",
        "another page drives",
    )
    state.put(ControlState(mode=ControlState.HOLD, who="operator", reason="the operator has let go"))
    held = bar.shown(page)
    assert (held["who"], held["why"]) == ("nobody drives", "the operator has let go")
    assert bar.shown(page_with("other"))["who"] == "nobody drives; another page has control"
    page.driver.delay, page.driver.is_other_driving = "delay 0.3 s: too long to drive", True
    late = bar.shown(page)
    assert (late["why"], late["alert"], "take over" in late["orders"]) == (page.driver.delay, True, True)


def test_only_operators_order_and_a_page_cannot_order_manual(state: Latest[ControlState]) -> None:
    bar, observer, page = bar_of(state), page_with(role=Role.OBSERVER), page_with()
    assert not bar.shown(observer)["is_operator"]
    bar.add_keys(observer)
    observer.add_key.assert_not_called()
    bar.add_keys(page)
    keys = {call.args[0]: call.args[2] for call in page.add_key.call_args_list}
    keys["g"]()
    for sent in ("HOLD", "MANUAL", {"mode": 0}, None):
        bar._on_order(page, Mock(args=sent))
    asked = [call.args[0] for call in page.ask.call_args_list]
    assert [(type(one), one.mode) for one in asked] == [(SetControl, 0), (SetControl, 2)]
    bar._on_order(page, Mock(args="take over"))
    page.driver.take_over.assert_called_once_with()


def test_orders_to_a_robot_elsewhere_are_wishes_that_pass_the_link(state: Latest[ControlState]) -> None:
    bar, page = bar_of(state), Mock()
    command: Any = bar._operators.command
    command.is_elsewhere = True
    bar.order(page, ControlState.AUTO)
    page.may.return_value = False
    bar.order(page, ControlState.HOLD)
    command.ask.assert_called_once_with(OperatorRequest.GO_ON)
    page.ask.assert_not_called()
