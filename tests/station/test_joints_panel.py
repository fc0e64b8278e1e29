"""Joints move by hand only while an operator holds a control, within their limits, and for nobody else."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robbie_mp import Message, ModuleHarness
from robbie_mp.messages import JointLimits, JointState
from robbie_mp.station.context import header_of_now
from robbie_mp.station.driving.dead_man import DeadManSwitch
from robbie_mp.station.driving.held_control import HeldControl
from robbie_mp.station.driving.seat import DriversSeat
from robbie_mp.station.panels.joints import JointsPanel, checked
from robbie_mp.station.watch.joints import MAX_JOINTS, JointsWatch
from robbie_robots.modules.devices.joints import SimulatedJointsModule

POSES = {"wave": {"wrist": 0.5}, "of another arm": {"elbow": 1.0}}


class Station:
    """The part of a station that the panel uses, with its messages."""

    def __init__(self) -> None:
        self.messages = self
        self.settings = SimpleNamespace(poses=POSES)
        self.command = SimpleNamespace(is_here=True, other="", text="", take=lambda: None)
        self.operators = SimpleNamespace(pages={}, seat=DriversSeat(), command=self.command)
        self.clock = SimpleNamespace(now_ns=lambda: 200_000_007)
        self.envelope = SimpleNamespace(topic="arm")
        self.handlers: dict[type[Message], Callable[[Any], None]] = {}
        self.joints = JointsWatch(self)  # type: ignore[arg-type]
        self.robot = SimpleNamespace(lights=None, joints=self.joints)

    def hear(self, message_type: type[Message], handler: Callable[[Any], None], _topic: str = "") -> None:
        self.handlers[message_type] = handler

    def tell(self, message: Message, topic: str = "arm") -> None:
        self.envelope.topic = topic
        self.handlers[type(message)](message)


def limits(*names: str) -> JointLimits:
    count = len(names)
    return JointLimits(name=[*names], lower=np.full(count, -1.0), upper=np.full(count, 2.0))


@pytest.fixture
def time_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


@pytest.fixture
def station() -> Station:
    return Station()


@pytest.fixture
def panel(station: Station) -> JointsPanel:
    made = JointsPanel(station)  # type: ignore[arg-type]
    station.tell(limits("wrist", "gripper"))
    return made


def test_position_is_shown_only_while_it_is_known(
    station: Station, panel: JointsPanel, time_s: list[float]
) -> None:
    wrist, gripper = panel.shown()
    assert (wrist["key"], wrist["lower"], wrist["upper"], wrist["at"]) == ("arm/wrist", -1.0, 2.0, None)
    assert (wrist["is_gripper"], gripper["is_gripper"]) == (False, True)
    station.tell(JointState(name=["wrist", "wheel", "gripper"], position=np.array([0.25, 1.0, np.nan])))
    assert [joint["at"] for joint in panel.shown()] == [0.25, None]
    station.tell(JointState(name=["wrist"], position=np.array([1.0])), topic="other")
    assert panel.shown()[0]["at"] == 0.25
    time_s[0] += 1.1
    assert panel.shown()[0]["at"] is None


def test_commands_expire_end_at_the_limits_and_go_to_the_module_of_each_joint(
    station: Station, panel: JointsPanel
) -> None:
    station.tell(limits("pan"), topic="neck")
    goals = {"arm/wrist": 9.0, "arm/gripper": -0.5, "neck/pan": 0.1, "arm/elbow": 1.0}
    commands = station.joints.commands(goals, 0.1, header_of_now(station.clock))
    assert {topic: dict(zip(one.name, one.position, strict=True)) for topic, one in commands.items()} == {
        "arm": {"wrist": 2.0, "gripper": -0.5},
        "neck": {"pan": 0.1},
    }
    assert all(one.based_on.nanoseconds == 100_000_007 for one in commands.values())
    assert all(0 < one.valid_for.nanoseconds <= 250_000_000 for one in commands.values())
    station.tell(limits("elbow"))  # the module has restarted with other joints
    assert [joint["key"] for joint in panel.shown()] == ["neck/pan", "arm/elbow"]


def test_joints_without_usable_limits_are_left_out_and_their_number_is_bounded(
    station: Station, panel: JointsPanel
) -> None:
    ends = np.array([0.0, np.inf, 1.0])
    station.tell(JointLimits(name=["a", "b", "c"], lower=np.zeros(3), upper=ends))
    assert [joint["name"] for joint in panel.shown()] == ["c"]
    station.tell(limits(*map(str, range(MAX_JOINTS + 5))))
    assert len(panel.shown()) == MAX_JOINTS


def test_only_poses_whose_joints_are_there_are_offered(panel: JointsPanel) -> None:
    assert panel.poses() == [{"name": "wave", "goals": [["arm/wrist", 0.5]]}]


@pytest.mark.parametrize(
    "sent",
    [None, {}, {"goals": 5, "sent_s": 0}, {"goals": [["a"]], "sent_s": 0},
     {"goals": [["a", "x"]], "sent_s": 0}, {"goals": [["a", float("nan")]], "sent_s": 0},
     {"goals": [], "sent_s": float("inf")}],
)  # fmt: skip
def test_malformed_events_are_ignored(sent: object) -> None:
    assert checked(sent) is None


def test_control_counts_only_for_the_operator_who_drives_and_while_it_is_fresh(
    station: Station, time_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setattr("nicegui.ui.notify", lambda text, **_options: shown.append(text))
    rights = {"one": True, "two": True, "observer": False}

    def control(key: str) -> HeldControl:
        page = SimpleNamespace(key=key, may=lambda _what: rights[key], dead_man=DeadManSwitch())
        page.dead_man.pong(page.dead_man.ping(time_s[0]), time_s[0], time_s[0])
        return HeldControl(station.operators, page, "moving a joint")  # type: ignore[arg-type]

    def begins(one: HeldControl) -> bool:
        return one.age_s(held=True, begins=True, sent_s=time_s[0]) is not None

    first, second = control("one"), control("two")
    assert not begins(control("observer"))
    assert begins(first)
    assert not begins(second)
    assert second.is_other_driving
    late = time_s[0] + 0.1
    time_s[0] += 0.5
    assert first.age_s(held=True, begins=False, sent_s=late) is None
    assert first.age_s(held=False, begins=False, sent_s=late) == pytest.approx(0.4, abs=0.01)
    assert second.age_s(held=False, begins=False, sent_s=late) is None
    assert first.stale == 1
    station.command.other, station.command.text = "pit", "the operator at pit drives"
    assert not begins(first)
    assert (first.refused, first.is_other_driving) == (1, True)
    assert shown == ["the operator at pit drives: your commands are refused. Take over to drive"]


def test_simulated_arm_follows_a_held_control_and_stops_when_it_is_released(station: Station) -> None:
    settings = {"names": ["wrist"], "least_rad": [-1.0], "most_rad": [2.0]}
    with ModuleHarness(SimulatedJointsModule, settings, name="arm") as arm:
        station.clock = SimpleNamespace(now_ns=arm.clock.now_ns)
        panel = JointsPanel(station)  # type: ignore[arg-type]
        station.tell(arm.take(JointLimits, "arm")[0])
        for _ in range(5):
            arm.send(
                station.joints.commands({"arm/wrist": 2.0}, 0.0, header_of_now(station.clock))["arm"],
                topic="arm",
            )
            arm.advance(0.1)
        arm.advance(1.0)
        station.tell(arm.take(JointState, "arm")[-1])
        at = panel.shown()[0]["at"]
    assert at == pytest.approx(0.5 + 0.07, abs=0.05), "it went on after its last command had expired"
