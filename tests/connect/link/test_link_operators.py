"""Two operators at the links of one robot: only the one who has control drives."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.cli.runs import live_runs
from robbie_mp.connect.link.clock_offset import Exchange
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.module import Link
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.messages import (
    ControlState,
    DriveCommand,
    Duration,
    EmergencyStop,
    Message,
    OperatorRequest,
    OperatorState,
    PanTiltCommand,
    SetControl,
    String,
    ToolReply,
    ToolRequest,
)
from tests._support.commands import waits
from tests._support.robot import Robot, wait_until
from tests.connect.link._support.pair import Pair

ACCEPT = {
    "anna": ["DriveCommand manual", "EmergencyStop emergency_stop"],
    "ben": ["DriveCommand manual", "EmergencyStop emergency_stop", "PanTiltCommand"],
    "guest": ["String"],
}
TAKE_OVER = OperatorRequest(wish=OperatorRequest.TAKE_OVER)


@pytest.fixture(scope="module", autouse=True)
def zenoh_has_started() -> None:
    """Zenoh keeps some descriptors until the process ends; have it open them before any test looks."""
    open_session(Endpoints()).close()


class RedRobot:
    """The link of robot `red`, with operators whose clocks are known."""

    def __init__(self, harness: ModuleHarness[Link]):
        self.harness, self.link = harness, harness.module

    def arrives(self, operator: str, message: Message, topic: str, *, age_s: float = 0.0) -> bool:
        """Whether a message of an operator is obeyed."""
        return self.fate(operator, message, topic, age_s=age_s) is Fate.PUBLISHED

    def fate(self, operator: str, message: Message, topic: str, *, age_s: float = 0.0) -> Fate:
        """Let a message of an operator arrive."""
        peer = self.link.node.meet(operator)
        assert peer is not None
        now_ns = self.harness.clock.monotonic_ns()
        peer.clock.add(Exchange(now_ns, now_ns, now_ns, now_ns))
        peer.last_beat_ns, peer._is_greeted = now_ns, True
        name = ChannelId(message.type_name, message.version, topic)
        stamp_ns = now_ns - round(age_s * 1e9)
        traffic = TrafficClass.URGENT
        if isinstance(message, DriveCommand | PanTiltCommand):
            traffic = TrafficClass.COMMAND
        arrived = Arrived(operator, 1, traffic, 0, name, message.encode(), stamp_ns, 0, False)
        return self.link.on_arrived(arrived)

    def drives(self, operator: str, *, age_s: float = 0.0) -> bool:
        """Whether a drive command of an operator is obeyed."""
        command = DriveCommand(linear_m_per_s=0.5, valid_for=Duration.from_nanoseconds(220_000_000))
        return self.arrives(operator, command, "manual", age_s=age_s)

    def told(self) -> OperatorState:
        """What operators are told now."""
        state = self.harness.latched(OperatorState, "operator_state")
        assert state is not None
        return state


@pytest.fixture
def red() -> Iterator[RedRobot]:
    with ModuleHarness(Link, {"robot": "red", "listen": [], "accept": ACCEPT}) as harness:
        harness.advance(2.0)
        yield RedRobot(harness)


def test_commands_of_a_second_operator_are_refused_counted_and_told(red: RedRobot) -> None:
    assert red.told().operator == ""
    assert red.drives("anna")
    assert not red.drives("ben")
    assert not red.arrives("ben", PanTiltCommand(valid_for=Duration(sec=1)), "pan_tilt")
    assert red.drives("anna")
    red.harness.advance(1.0)
    state = red.told()
    assert (state.operator, state.refused, state.refused_operator) == ("anna", 2, "ben")
    assert len([one for one in red.harness.published_encoded if "DriveCommand" in one.type_name]) == 2


def test_operator_with_the_command_lets_the_robot_go_on_and_everybody_lets_it_hold(red: RedRobot) -> None:
    go_on, hold = OperatorRequest(wish=OperatorRequest.GO_ON), OperatorRequest(wish=OperatorRequest.HOLD)
    assert red.drives("anna")
    assert red.arrives("anna", go_on, "operator_request")
    assert not red.arrives("ben", go_on, "operator_request")
    assert not red.arrives("guest", hold, "operator_request")
    assert red.arrives("ben", hold, "operator_request")
    red.harness.advance(0.1)
    orders = red.harness.take(SetControl)
    assert [(one.mode, one.reason) for one in orders] == [
        (ControlState.AUTO, "ordered by anna"),
        (ControlState.HOLD, "ordered by ben"),
    ]
    assert red.told().operator == "anna"


def test_take_over_is_explicit_and_told(red: RedRobot) -> None:
    red.drives("anna")
    assert red.arrives("ben", TAKE_OVER, "operator_request")
    assert red.told().operator == "ben"
    assert not red.drives("anna")
    assert red.drives("ben")


def test_late_command_takes_nothing_and_late_take_over_is_thrown_away(red: RedRobot) -> None:
    assert not red.drives("ben", age_s=0.5)
    assert red.told().operator == ""
    red.drives("anna")
    assert not red.arrives("ben", TAKE_OVER, "operator_request", age_s=0.5)
    assert red.told().operator == "anna"


def test_wish_to_hold_never_comes_too_late_and_the_order_to_go_on_does(red: RedRobot) -> None:
    go_on, hold = OperatorRequest(wish=OperatorRequest.GO_ON), OperatorRequest(wish=OperatorRequest.HOLD)
    assert not red.arrives("anna", go_on, "operator_request", age_s=0.5)
    assert red.arrives("anna", hold, "operator_request", age_s=5.0)
    red.harness.advance(0.1)
    assert [one.mode for one in red.harness.take(SetControl)] == [ControlState.HOLD]


def test_order_to_go_on_that_waited_in_the_link_is_late_and_to_hold_is_not(red: RedRobot) -> None:
    assert red.drives("anna")
    for wish in (OperatorRequest.GO_ON, OperatorRequest.HOLD):
        assert red.arrives("anna", OperatorRequest(wish=wish), "operator_request")
    red.harness.clock.advance(5.0)  # the link stood still
    red.harness.advance(0.1)
    assert [one.mode for one in red.harness.take(SetControl)] == [ControlState.HOLD]


@pytest.mark.parametrize("traffic", ["command", "reliable", "state", "bulk"])
def test_commands_of_a_log_that_is_played_go_to_no_other_robot(traffic: str) -> None:
    settings = {"robot": "base", "listen": [], "robots": ["red"], "send": {traffic: ["DriveCommand"]}}
    with ModuleHarness(Link, settings) as harness:
        offered: list[object] = []
        harness.module.node.offer = lambda message, now_ns: offered.append(message)  # type: ignore[method-assign]
        for harness.module.plays in (False, True):
            harness.send(DriveCommand(linear_m_per_s=0.5), topic="manual")
            harness.send(OperatorRequest(wish=OperatorRequest.GO_ON), topic="operator_request")
        assert (len(offered), harness.module.withheld) == (2, 2)


def test_wish_of_the_own_page_that_waited_in_a_stopped_link_is_late(
    red: RedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits(red.harness, monkeypatch, 1.0)
    for wish in (OperatorRequest.GO_ON, OperatorRequest.TAKE_OVER, OperatorRequest.HOLD):
        red.harness.send(OperatorRequest(wish=wish), topic="operator_request", sender="operator")
    red.harness.advance(0.1)
    assert [one.mode for one in red.harness.take(SetControl)] == [ControlState.HOLD]
    assert (red.told().operator, red.link.late) == ("", 2)


def test_wish_is_sent_with_the_time_at_which_the_page_published_it(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"robot": "anna", "listen": [], "send": {"command": ["DriveCommand manual"]}}
    with ModuleHarness(Link, settings) as harness:
        harness.advance(2.0)
        waits(harness, monkeypatch, 1.0)
        offered: list[int] = []
        monkeypatch.setattr(harness.module.node, "offer", lambda one, _now_ns: offered.append(one.stamp_ns))
        request = OperatorRequest(wish=OperatorRequest.GO_ON)
        harness.send(request, topic="operator_request", sender="operator")
        assert offered == [harness.clock.monotonic_ns() - 1_000_000_000]


def test_who_may_not_drive_cannot_take_over(red: RedRobot) -> None:
    red.drives("anna")
    assert not red.arrives("guest", TAKE_OVER, "operator_request")
    assert red.told().operator == "anna"


def test_everybody_stops_the_robot(red: RedRobot) -> None:
    red.drives("anna")
    assert red.arrives("ben", EmergencyStop(engaged=True), "emergency_stop")


def test_own_page_of_the_robot_shares_the_command(red: RedRobot) -> None:
    red.drives("anna")
    red.harness.send(OperatorRequest(wish=OperatorRequest.TAKE), topic="operator_request", sender="operator")
    assert red.told().operator == "anna"
    red.harness.send(TAKE_OVER, topic="operator_request", sender="operator")
    assert red.told().operator == "red"
    assert not red.drives("anna")


@pytest.mark.parametrize(
    ("message", "age_s", "fate"),
    [
        (EmergencyStop(engaged=True), 5.0, Fate.NO_ROOM),
        (String(data="lights on"), 0.1, Fate.NO_ROOM),
        (String(data="lights on"), 0.5, Fate.REFUSED),
    ],
)
def test_no_stop_waits_behind_something_urgent_without_room(
    message: Message, age_s: float, fate: Fate, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ModuleHarness(Link, {"robot": "red", "listen": [], "accept": {"*": ["*"]}}) as harness:
        harness.advance(2.0)
        monkeypatch.setattr(harness.module, "publish_encoded", lambda *_, **__: False)
        assert RedRobot(harness).fate("anna", message, "urgent", age_s=age_s) is fate


def test_restarted_link_gives_the_command_to_nobody_else(red: RedRobot) -> None:
    red.drives("anna")
    settings = {"robot": "red", "listen": [], "accept": ACCEPT}
    with ModuleHarness(Link, settings, restored=red.harness.checkpoint) as harness:
        harness.advance(0.1)
        assert not RedRobot(harness).drives("ben")


@pytest.mark.parametrize(
    ("operator", "tool", "age_s", "why"),
    [
        ("guest", "param", 0.0, "red does not accept this from here"),
        ("anna", "param", 0.0, "red does not accept this from here"),
        ("ben", "call", 0.0, "anna drives; take over first"),
        ("ben", "top", 6.0, "red got this more than 5 s late"),
    ],
)
def test_command_that_is_refused_is_answered_with_the_reason(
    operator: str, tool: str, age_s: float, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    accept = {**ACCEPT, "ben": [*ACCEPT["ben"], "ToolRequest call", "ToolRequest top"]}
    with ModuleHarness(Link, {"robot": "red", "listen": [], "accept": accept}) as harness:
        harness.advance(2.0)
        red = RedRobot(harness)
        assert red.drives("anna")
        sent: list[tuple[str, bytes]] = []
        monkeypatch.setattr(
            harness.module.node, "offer_to", lambda robot, one, _now_ns: sent.append((robot, one.data))
        )
        red.arrives(operator, ToolRequest(request=3, robot="red"), tool, age_s=age_s)
        harness.advance(0.02)
        ((robot, data),) = sent
        reply = ToolReply.decode(data)
        assert (robot, reply.request, reply.is_over) == (operator, 3, True)
        assert reply.error.startswith(why)
        harness.advance(1.0)
        assert "0 commands run for others, 1 refused" in harness.module.status


def test_replies_come_only_from_robots_that_were_asked(red: RedRobot) -> None:
    assert not red.arrives("guest", ToolReply(request=1), "tool_reply/0")
    red.harness.send(ToolRequest(request=1, robot="green"), topic="top", sender="tool")
    (said,) = red.harness.take(ToolReply)
    assert said.error.startswith("green cannot be reached; the link says: ")


def test_emergency_stop_cannot_be_limited_to_one_operator() -> None:
    with pytest.raises(SettingError, match="includes the emergency stop"):
        ModuleHarness(Link, {"robot": "red", "commanding": ["DriveCommand", "*Stop"]})


def test_robot_tells_only_about_itself_who_drives(red: RedRobot) -> None:
    assert red.arrives("guest", OperatorState(robot="guest", operator="ben"), "operator_state")
    assert not red.arrives("guest", OperatorState(robot="anna", operator="ben"), "operator_state")


@pytest.mark.parametrize("accept", [{}, {"blue": ["PoseStamped"]}])
def test_robot_that_nobody_drives_tells_nothing(accept: dict[str, list[str]]) -> None:
    with ModuleHarness(Link, {"robot": "red", "listen": [], "accept": accept}) as harness:
        harness.advance(1.1)
        assert harness.latched(OperatorState, "operator_state") is None


@pytest.mark.slow
def test_second_laptop_drives_only_after_it_has_taken_over(robot: Robot) -> None:
    wheels, pilot = (f'  it: {{class: "crew.modules:{one}"}}' for one in ("Wheels", "Pilot"))
    pair = Pair(robot, wheels, pilot)
    address = f"[{pair.address}]"
    pair._write("red", wheels, address, "[]", "{}", '{"*": ["*"]}')
    for name in ("anna", "ben"):
        pair._write(name, pilot, "[]", address, '{command: ["DriveCommand manual"]}', "{}")

    def told(name: str) -> dict[str, Any]:
        """What an operator is told."""
        (run,) = (one for one in live_runs() if one.record is not None and one.record.profile == name)
        ended = robot.command("echo", "operator_state", "--once", "--json", "--run", run.run_id)
        return dict(json.loads(ended.stdout)["message"])

    pair.start("red", "anna")
    wait_until(lambda: len(pair.numbers("red", "commands")) > 5)
    pair.start("ben")
    wait_until(lambda: pair.state("ben") is not None)
    wait_until(lambda: told("anna")["refused_operator"] == "ben")
    wait_until(lambda: told("ben")["operator"] == "anna")
    (run,) = (one for one in live_runs() if one.record is not None and one.record.profile == "ben")
    robot.command("pub", "OperatorRequest", "{wish: 1}", "--topic", "operator_request", "--run", run.run_id)
    wait_until(lambda: told("anna")["operator"] == "ben")
    wait_until(lambda: told("ben")["refused_operator"] == "anna")
