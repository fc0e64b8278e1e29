"""The simulated arm as a module: limits of the URDF, commands that expire, the gripper, restarts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Duration, ModuleHarness, SettingError
from robbie_mp.messages import JointCommand, JointLimits, JointState, Odometry
from robbie_robots.modules.manipulation.messages import TabletopTruth
from robbie_robots.modules.manipulation.simulated_arm import SimulatedArm
from tests._support.commands import fresh
from tests._support.places import ARENAS, PROJECT

ROBOT = PROJECT / "hw/robots/home.urdf"
NAMES = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll", "gripper"]
SETTINGS = {"arena": str(ARENAS / "arm.yaml"), "robot": str(ROBOT), "names": NAMES}


def command(position: dict[str, float], valid_for_s: float) -> JointCommand:
    return JointCommand(
        name=[*position],
        position=np.array([*position.values()]),
        valid_for=Duration.from_nanoseconds(round(valid_for_s * 1e9)),
    )


def hold(arm: ModuleHarness[SimulatedArm], position: dict[str, float], for_s: float) -> None:
    """Command at 10 Hz."""
    for _ in range(round(for_s * 10)):
        arm.send(fresh(arm, command(position, 0.3)), topic="module")
        arm.advance(0.1)


@pytest.fixture
def arm() -> Iterator[ModuleHarness[SimulatedArm]]:
    with ModuleHarness(SimulatedArm, SETTINGS) as harness:
        harness.send(Odometry(), topic="ground_truth")
        yield harness


def newest(arm: ModuleHarness[SimulatedArm]) -> dict[str, float]:
    state = arm.take(JointState)[-1]
    return dict(zip(state.name, state.position.tolist(), strict=True))


def test_limits_and_speeds_are_those_of_the_urdf(arm: ModuleHarness[SimulatedArm]) -> None:
    (limits,) = arm.take(JointLimits)
    assert limits.name == NAMES
    assert (limits.lower[1], limits.upper[1], limits.upper[6]) == (-1.85, 1.75, 0.045)
    hold(arm, {"shoulder": 1.0, "waist": 9.0}, 0.5)
    at = newest(arm)
    assert [at["shoulder"], at["waist"]] == pytest.approx([0.6, 0.75], abs=0.07)
    hold(arm, {"shoulder": 1.0, "waist": 9.0}, 3.0)
    assert newest(arm)["waist"] == pytest.approx(2.9)


def test_arm_stands_still_when_its_command_expires(arm: ModuleHarness[SimulatedArm]) -> None:
    arm.send(fresh(arm, command({"shoulder": 1.0}, 0.2)), topic="module")
    arm.advance(0.5)
    there = newest(arm)
    assert there["shoulder"] == pytest.approx(0.24, abs=0.01)
    arm.advance(1.0)
    assert newest(arm) == there
    assert arm.module.status.endswith("1 expired commands")


def test_restarted_arm_is_where_it_was_and_holds_what_it_held(arm: ModuleHarness[SimulatedArm]) -> None:
    hold(arm, {"elbow": 0.5, "gripper": 0.02}, 2.0)
    before = newest(arm)
    assert before["elbow"] == pytest.approx(0.5)
    truth = arm.take(TabletopTruth)[-1]
    assert truth.names == ["soup", "tea", "cola"]
    with ModuleHarness(SimulatedArm, SETTINGS, restored=arm.checkpoint) as again:
        again.send(Odometry(), topic="ground_truth")
        again.advance(0.2)
        assert newest(again) == before
        assert again.take(TabletopTruth)[-1].poses == truth.poses


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"names": ["wasit", "gripper"]}, "has no joint 'wasit' with limits; it has pan, tilt, waist"),
        ({"names": ["gripper", "gripper"]}, "each with a name that no other has"),
        ({"start": [1.0]}, "expected x, y"),
        ({"names": ["waist"]}, "one of the joints must be 'gripper'"),
        ({"names": ["right_finger", "gripper"]}, "has no joint 'right_finger'"),
        ({"rest": [1.0]}, "expected a value for each of the 7 joints"),
    ],
)
def test_mistakes_in_the_settings_are_named_before_anything_starts(
    change: dict[str, object], problem: str
) -> None:
    settings = {
        **SETTINGS,
        "arena": ARENAS / "arm.yaml",
        "robot": Path(ROBOT),
        "start": [],
        "rest": [],
        **change,
    }
    with pytest.raises(SettingError, match=problem):
        SimulatedArm.check(settings)
