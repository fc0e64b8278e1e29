"""The arm picks up and puts down simulated objects by what a simulated depth camera sees."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from robbie_mp.base.state_machine import mermaid
from robbie_mp.bus.checkpoint.image import decode, encode
from robbie_robots.hw.joints import Joint
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.joints import SimulatedJoints
from robbie_robots.hw.simulation.solid import Solid, pose_at
from robbie_robots.hw.simulation.tabletop import TableObject, Tabletop
from robbie_robots.hw.simulation.taking_person import TakingPerson
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, table_solids
from robbie_robots.workers.manipulation.arm_model import ArmModel
from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.hand_work import HandOutcome, HandWork
from robbie_robots.workers.manipulation.hand_work_states import (
    TIME_OUTS,
    TRANSITIONS,
    HandSettings,
    HandState,
)
from robbie_robots.workers.manipulation.table_view import TableView
from tests._support.places import ARENAS, DOCS, PROJECT

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")

ROBOT = PROJECT / "hw/robots/home.urdf"
JOINTS = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll"]
ARENA = read_arena(ARENAS / "arm.yaml")
STANDS = Pose(3.39, 1.78, 0.03)
STEP_S = 0.04
PICKS = "RECOVER FREE ASIDE LOOK APPROACH REACH CLOSE LIFT STOW"
PUTS = "RECOVER LIFT ASIDE LOOK APPROACH REACH OPEN WITHDRAW STOW"


class World:
    """The arm, the objects, and an eye that sees them with a small error."""

    def __init__(self) -> None:
        self.now_s = 10.0
        self.shapes = RobotShapes(ROBOT)
        joints = []
        for name in (*JOINTS, "gripper"):
            joint = self.shapes.joints[name]
            assert joint.limits is not None and joint.max_speed is not None
            joints.append(Joint(name, *joint.limits, joint.max_speed))
        at = dict(zip(JOINTS, HandSettings().stow, strict=True))
        self.joints = SimulatedJoints(joints, lambda: self.now_s, at)
        self.objects = Tabletop(
            [
                TableObject(
                    one.name,
                    Solid(one.size_m, one.is_round),
                    pose_at((one.x_m, one.y_m, one.base_m + one.size_m[2] / 2), one.yaw_rad),
                )
                for one in ARENA.objects
            ],
            table_solids(ARENA),
        )
        self.arm = ArmModel(ROBOT, JOINTS, ["gripper", "right_finger"])
        self.states: list[HandState] = []
        self.is_blind = self.is_silent = False
        self.person = TakingPerson(1.0, 10.0)
        self.people: list[tuple[float, float]] = []
        self.before: Callable[[], None] = lambda: None
        self.work = self.new_work()

    def new_work(self) -> HandWork:
        return HandWork(self.arm, lambda: self.now_s, on_change=self.states.append)

    def view(self) -> TableView:
        X_BA = np.linalg.inv(pose_at((STANDS.x_m, STANDS.y_m, 0.0), STANDS.heading_rad))
        table = table_solids(ARENA)[0]
        objects = [
            Shape(one.name, one.solid.size_m, X_BA @ self.objects.pose(one.name), one.solid.is_round)
            for one in self.objects.objects
            if one.name != self.objects.held
        ]
        for shape in objects:
            shape.pose[:2, 3] += 0.003
        return TableView(self.now_s, Shape("table", table.solid.size_m, X_BA @ table.pose), tuple(objects))

    def run(self, limit_s: float = 60.0, until: HandState | None = None) -> HandOutcome | None:
        end_s = self.now_s + limit_s
        for turn in itertools.count():
            if self.now_s > end_s or self.work.outcome is not None or self.work.machine.state is until:
                return self.work.outcome
            self.now_s += STEP_S
            self.before()
            self.shapes.move(self.at())
            hand = self.shapes.pose("grasp_point", STANDS)
            least = self.objects.step(
                hand, self.at()["gripper"], self.shapes.arm(STANDS), self.person.has_hold
            )
            held_out = hand[:3, 3] if self.objects.held else None
            pull = self.person.pull(self.now_s, held_out, self.people)
            self.joints.block("gripper", least or None)
            if not self.is_silent:
                positions = np.array([self.at()[name] for name in JOINTS])
                self.work.see_joints(positions, self.at()["gripper"], self.now_s)
                self.work.see_efforts(
                    np.array([self.shapes.torque_nm(name, STANDS, hand[:3, 3], pull) for name in JOINTS])
                )
            if turn % 10 == 0 and not self.is_blind:
                self.work.see_table(self.view())
            order = self.work.step()
            if order is not None:
                goals = dict(zip(JOINTS, order.positions.tolist(), strict=True))
                self.joints.command({**goals, "gripper": float(order.half_opening_m)}, 0.3)
        raise AssertionError

    def restart(self, state: HandState) -> None:
        """Kill the process when it comes to a state; its commands expire before the next one goes on."""
        self.run(until=state)
        assert self.work.machine.state is state
        kept = decode(encode(self.work.memory())).state
        self.now_s += 1.0
        self.work = self.new_work()
        self.work.remember(kept)

    def at(self) -> dict[str, float]:
        return dict(zip([*JOINTS, "gripper"], self.joints.read().positions_rad, strict=True))

    def stands(self, name: str) -> bool:
        return not self.objects.lies(name) and self.objects.pose(name)[2, 3] > 0.4

    @property
    def is_unharmed(self) -> bool:
        return not (self.objects.knocked or self.objects.contacts or self.objects.slips)


@pytest.mark.slow
def test_arm_picks_up_carries_and_puts_down_without_touching_anything_else() -> None:
    world = World()
    world.work.pick_up("tea")
    assert world.run() == HandOutcome(True, "holds tea")
    assert (world.objects.held, world.work.tries) == ("tea", 0)
    hand = world.arm.pose(np.array([world.at()[name] for name in JOINTS]))
    assert np.hypot(*hand[:2, 3]) < 0.25  # above the robot
    before = world.objects.pose("tea").copy()
    world.work.put_down()
    assert world.run() == HandOutcome(True, "has put down tea")
    assert world.objects.held is None
    assert world.stands("tea") and not np.allclose(before, world.objects.pose("tea"))
    assert world.is_unharmed
    assert world.states[:9] == [
        HandState.RECOVER, HandState.FREE, HandState.ASIDE, HandState.LOOK, HandState.APPROACH,
        HandState.REACH, HandState.CLOSE, HandState.LIFT, HandState.STOW,
    ]  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.slow
@pytest.mark.parametrize("state", [HandState[name] for name in PICKS.split()])
def test_next_process_finishes_what_the_last_one_began(state: HandState) -> None:
    world = World()
    world.work.pick_up("soup")
    world.restart(state)
    assert world.run() == HandOutcome(True, "holds soup")
    assert world.objects.held == "soup"
    assert world.is_unharmed


@pytest.mark.sampled(3)
@pytest.mark.slow
@pytest.mark.parametrize("state", [HandState[name] for name in PUTS.split()])
def test_next_process_puts_down_what_the_last_one_held_or_knows_that_it_has(state: HandState) -> None:
    world = World()
    world.work.pick_up("soup")
    world.run()
    world.work.put_down()
    world.restart(state)
    assert world.run() == HandOutcome(True, "has put down soup")
    assert world.objects.held is None and world.stands("soup")
    assert world.is_unharmed


@pytest.mark.slow
def test_gripper_that_closes_on_nothing_tries_again() -> None:
    world = World()
    world.work.pick_up("cola")
    world.run(until=HandState.CLOSE)

    def take_away() -> None:
        if world.work.tries == 0:
            world.objects.pose("cola")[:3, 3] += [0.0, 0.0, -0.2 if world.stands("cola") else 0.0]
        elif world.objects.pose("cola")[2, 3] < 0.4:
            world.objects.pose("cola")[2, 3] += 0.2

    world.before = take_away
    assert world.run(120.0) == HandOutcome(True, "holds cola")
    assert world.work.tries == 1


@pytest.mark.slow
def test_orders_that_cannot_be_done_end_with_the_reason() -> None:
    world = World()
    world.work.pick_up("mustard")
    outcome = world.run(120.0)
    assert outcome == HandOutcome(False, "sees no mustard on a table")
    world.is_blind = True
    world.work.pick_up("soup")
    assert world.run(120.0) == HandOutcome(False, "sees no table")
    world.work.put_down()
    outcome = world.run(120.0)
    assert outcome is not None and not outcome.is_done
    assert world.is_unharmed


def test_arm_is_stowed_before_a_failed_order_ends_because_the_robot_then_drives() -> None:
    world = World()
    world.work.pick_up("mustard")
    world.restart(HandState.STOW)
    assert world.run() == HandOutcome(False, "sees no mustard on a table")
    at = np.array([world.at()[name] for name in JOINTS])
    np.testing.assert_allclose(at, HandSettings().stow, atol=0.03)


def test_arm_that_was_stopped_stands_out_until_it_is_stowed() -> None:
    world = World()
    world.work.pick_up("soup")
    world.run(until=HandState.APPROACH)
    world.work.stop("enough")
    assert world.work.stands_out
    world.work.stow()
    assert world.run() == HandOutcome(True, "is stowed")
    at = np.array([world.at()[name] for name in JOINTS])
    np.testing.assert_allclose(at, HandSettings().stow, atol=0.03)
    assert world.is_unharmed


@pytest.mark.slow
def test_arm_stows_what_it_holds_if_there_is_no_table_to_put_it_on() -> None:
    world = World()
    world.work.pick_up("soup")
    world.run()
    world.is_blind = True
    world.work.put_down()
    assert world.run(120.0) == HandOutcome(False, "sees no table")
    at = np.array([world.at()[name] for name in JOINTS])
    np.testing.assert_allclose(at, HandSettings().stow, atol=0.03)
    assert (world.objects.held, world.is_unharmed) == ("soup", True)


@pytest.mark.slow
def test_arm_stands_still_while_its_joints_are_silent_and_then_goes_on() -> None:
    world = World()
    world.work.pick_up("soup")
    world.run(until=HandState.APPROACH)
    world.is_silent = True
    world.run(2.0)
    there = world.at()
    world.run(1.0)
    assert world.at() == there
    world.is_silent = False
    assert world.run() == HandOutcome(True, "holds soup")
    assert world.is_unharmed


def test_state_diagram_in_the_documentation_matches_the_declaration() -> None:
    page = (DOCS / "manipulation.md").read_text()
    assert mermaid(HandState.REST, TRANSITIONS, TIME_OUTS) in page


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.parametrize("restarts", [False, True])
def test_object_is_held_out_upright_and_let_go_when_a_person_pulls(restarts: bool) -> None:
    world = World()
    world.people = [(STANDS.x_m + 1.0, STANDS.y_m + 0.2)]
    world.work.pick_up("cola")
    world.run()
    world.work.outcome = None
    world.work.hand_over()
    world.run(until=HandState.OFFER)
    if restarts:
        world.restart(HandState.OFFER)
    world.run(until=HandState.OPEN)
    held = world.objects.pose("cola")
    assert world.objects.held == "cola"
    assert held[2, 2] > 0.95
    assert held[2, 3] > 0.55
    assert world.run() == HandOutcome(True, "has handed over cola")
    assert world.objects.is_taken("cola")


@pytest.mark.slow
def test_arm_keeps_what_nobody_takes() -> None:
    world = World()
    world.work.pick_up("cola")
    world.run()
    world.work.outcome = None
    world.work.hand_over()
    assert world.run() == HandOutcome(False, "nobody has taken cola")
    at = np.array([world.at()[name] for name in JOINTS])
    np.testing.assert_allclose(at, HandSettings().stow, atol=0.03)
    assert (world.objects.held, world.is_unharmed) == ("cola", True)


def test_empty_hand_hands_nothing_over() -> None:
    world = World()
    world.work.hand_over()
    assert world.run() == HandOutcome(False, "there is nothing in the hand")
