"""The task, played on a drawn map by a robot that jumps to its goals."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from robbie_robots.workers.numbers.mission import NumbersMission, NumbersOrder
from robbie_robots.workers.numbers.mission_states import NumbersSettings, NumbersState
from robbie_robots.workers.numbers.mission_targets import SignReport
from robbie_robots.workers.numbers.sign_map import ALL_SECTORS

RESOLUTION_M, SIZE = 0.1, 120
SETTINGS = NumbersSettings(sheet_images=3)


class World:
    """A square ground of 12 m; digit k stands at PLACES[k] and faces the middle, an other post at the end."""

    def __init__(self, signs: list[SignReport], settings: NumbersSettings = SETTINGS) -> None:
        self.now_s = 0.0
        self.signs = signs
        self.images = 0
        self.sheet = ""
        self.pose = np.array([6.0, 6.0, 0.0])
        self.states: list[NumbersState] = []
        self.visits: list[np.ndarray] = []
        self.blocked: list[np.ndarray] = []
        self.settings = settings
        self.mission = self.new_mission()

    def new_mission(self) -> NumbersMission:
        mission = NumbersMission(lambda: self.now_s, self.settings, self.states.append)
        mission.see_stopped(None)
        return mission

    def step(self) -> NumbersOrder:
        self.now_s += 0.5
        self.images += 1
        cells = np.zeros((SIZE, SIZE), np.int8)
        cells[[0, -1]] = cells[:, [0, -1]] = 100
        for sign in self.signs:
            column, row = (np.array(sign.xy_m) / RESOLUTION_M).astype(int)
            cells[row, column] = 100
        self.mission.see_map(cells, RESOLUTION_M, (0.0, 0.0))
        self.mission.see_pose(self.pose)
        self.mission.see_signs(self.signs, self.sheet, self.images)
        orders = self.mission.step()
        if orders.goal is not None:
            if any(np.array_equal(orders.goal, place) for place in self.blocked):
                self.mission.unreachable("blocked")
            else:
                self.pose = orders.goal
                self.mission.arrived()
        return orders

    def play(self, until: Callable[[], bool], steps: int = 600) -> None:
        for _ in range(steps):
            if until():
                return
            self.step()
        raise AssertionError(f"never happened; {self.mission.status}")

    @property
    def is_over(self) -> bool:
        return self.mission.machine.is_final


def sign(digit: int | None, x_m: float, y_m: float, searched: int = 0) -> SignReport:
    facing_rad = math.atan2(6.0 - y_m, 6.0 - x_m) if digit is not None else math.nan
    return SignReport((x_m, y_m), facing_rad, digit, digit is None, searched)


def around(digits: list[int]) -> list[SignReport]:
    """Signs on a circle of 4 m."""
    angles = np.linspace(0, math.tau, len(digits), endpoint=False).tolist()
    return [
        sign(digit, 6.0 + 4 * math.cos(angle), 6.0 + 4 * math.sin(angle))
        for digit, angle in zip(digits, angles, strict=True)
    ]


def test_all_digits_are_reached_in_ascending_order_from_in_front() -> None:
    world = World(around([3, 1, 4, 0, 5, 9, 2, 6, 8, 7]))
    reached: list[int] = []

    def watch() -> bool:
        if len(world.mission.reached) > len(reached):
            reached.append(world.mission.reached[-1])
            [there] = [one for one in world.signs if one.digit == reached[-1]]
            offset = world.pose[:2] - there.xy_m
            assert math.hypot(*offset) <= 1.1
            aside_rad = math.remainder(math.atan2(offset[1], offset[0]) - there.facing_rad, math.tau)
            assert abs(aside_rad) < 0.8
        return world.is_over

    world.play(watch)
    assert reached == list(range(10))
    assert world.mission.machine.reason == "has reached all numbers"


def test_sheet_gives_the_order_and_the_number_of_visits() -> None:
    world = World(around([1, 4, 7]))
    world.sheet = "417"
    world.play(lambda: world.is_over)
    assert world.mission.reached == [4, 1, 7]


def test_robot_stands_until_enough_images_have_shown_no_sheet() -> None:
    world = World(around([0, 1]), replace(SETTINGS, sheet_images=20))
    for _ in range(15):
        assert world.step().goal is None
    assert world.mission.state is NumbersState.SHEET
    world.play(lambda: world.mission.state is NumbersState.LOOK)
    assert world.mission.order == tuple(range(10))


def test_missing_number_is_searched_at_open_posts_and_then_reached() -> None:
    hidden, other = sign(None, 9.0, 9.0), sign(None, 3.0, 3.0)
    world = World([hidden, other])
    world.sheet = "5"
    world.play(lambda: NumbersState.VIEW in world.states)
    looked = [math.dist(world.pose[:2], one.xy_m) for one in (hidden, other)]
    assert 1.5 < min(looked) < 3.2
    world.signs = [sign(5, 9.0, 9.0), replace(other, is_open=False)]
    world.play(lambda: world.is_over)
    assert world.mission.reached == [5]


def test_robot_looks_at_a_post_from_every_side_and_then_gives_up() -> None:
    world = World([sign(None, 8.0, 6.0)], replace(SETTINGS, max_rounds=0))
    world.sheet = "5"
    world.play(lambda: world.is_over)
    assert 4 <= world.states.count(NumbersState.VIEW) <= 8
    assert world.mission.machine.reason == "did not find a way to number 5"


def test_refused_and_searched_posts_are_looked_at_again_in_the_next_round() -> None:
    searched = SignReport((8.0, 6.0), math.nan, None, False, ALL_SECTORS)
    world = World([searched], replace(SETTINGS, max_rounds=1))
    world.sheet = "5"
    world.play(lambda: world.is_over)
    assert 4 <= world.states.count(NumbersState.VIEW) <= 8


def test_goal_that_cannot_be_reached_is_replaced_by_another_one_in_front() -> None:
    world = World([sign(5, 9.0, 6.0)])
    world.sheet = "5"
    while (goal := world.step().goal) is None:
        assert world.now_s < 100.0
    world = World([sign(5, 9.0, 6.0)])
    world.sheet, world.blocked = "5", [goal]
    world.play(lambda: world.is_over)
    assert world.mission.reached == [5]
    assert not np.allclose(world.pose, goal)


def test_sign_that_is_not_where_it_was_is_not_said_to_be_reached() -> None:
    world = World([sign(5, 9.0, 6.0)])
    world.sheet = "5"
    world.play(lambda: world.mission.state is NumbersState.LOOK)
    while world.mission.step().goal is None:
        world.now_s += 0.5
    world.mission.see_pose([2.0, 2.0, 0.0])
    world.mission.arrived()
    assert world.mission.reached == []
    assert world.mission.state is NumbersState.EXPLORE


@pytest.mark.parametrize("is_there", [False, True])
def test_board_that_turns_out_to_face_elsewhere_is_visited_in_its_true_front(is_there: bool) -> None:
    """The facing seen from afar may be wrong: until the robot says that it is there, it can be fixed."""
    world = World([sign(5, 9.0, 6.0)])
    world.sheet = "5"
    world.play(lambda: world.mission.state is NumbersState.LOOK)
    while (goal := world.mission.step().goal) is None:
        world.now_s += 0.5
    true_rad = world.signs[0].facing_rad + 1.5
    world.signs = [replace(world.signs[0], facing_rad=true_rad)]
    world.mission.see_signs(world.signs, "5", world.images)
    if is_there:
        world.mission.see_pose(goal)
        world.mission.arrived()
        assert world.mission.reached == []
    else:
        world.now_s += 1.5
        other = world.mission.step().goal
        assert other is not None
        assert math.dist(other[:2], goal[:2]) > 0.5
    world.play(lambda: world.is_over)
    assert world.mission.reached == [5]
    offset = world.pose[:2] - world.signs[0].xy_m
    assert abs(math.remainder(math.atan2(offset[1], offset[0]) - true_rad, math.tau)) < 0.8


def test_number_that_was_read_but_is_never_sure_is_visited_after_a_round_in_vain() -> None:
    likely = replace(sign(None, 9.0, 6.0), facing_rad=math.pi, likely=5, views=4)
    world = World([likely, replace(sign(None, 3.0, 6.0), is_open=False)])
    world.sheet = "5"
    world.play(lambda: world.is_over)
    assert world.mission.reached == [5]
    assert world.states.count(NumbersState.VIEW) >= 2  # it has tried to make sure
    assert world.pose[0] == pytest.approx(8.2, abs=0.3)


def test_robot_halts_while_navigation_cannot_drive_and_then_goes_on() -> None:
    world = World(around([0, 1, 2]))
    world.sheet = "012"
    world.play(lambda: world.mission.reached == [0])
    world.mission.see_stopped("STOPPED_NO_LASER: no scan")
    assert world.step().goal is None
    assert world.mission.state is NumbersState.HALT
    world.mission.see_stopped(None)
    world.play(lambda: world.is_over)
    assert world.mission.reached == [0, 1, 2]


def test_restarted_mission_goes_on_with_the_next_number() -> None:
    world = World(around([0, 1, 2]))
    world.sheet = "120"
    world.play(lambda: len(world.mission.reached) == 2)
    memory = world.mission.memory()
    world.sheet = ""  # it has been taken away
    world.mission = world.new_mission()
    world.mission.remember(memory)
    assert world.mission.reached == [1, 2]
    world.play(lambda: world.is_over)
    assert world.mission.reached == [1, 2, 0]


@pytest.mark.parametrize("reached", [[0], []])
def test_restarted_mission_that_had_ended_stays_so(reached: list[int]) -> None:
    world = World(around([0]))
    world.mission.remember({**world.mission.memory(), "order": [0], "reached": reached, "over": "the end"})
    assert world.mission.state is NumbersState.DONE
    assert world.mission.machine.reason == "the end"


def test_task_ends_when_its_time_is_over() -> None:
    world = World(around([0]), replace(SETTINGS, time_limit_s=5.0))
    world.play(lambda: world.is_over, steps=12)
    assert world.mission.machine.reason == "the time is over"
