"""The search for numbers on drawn grounds: a robot that jumps to its goals, and a camera.

The camera turns at once. It reads a board from 1.6 to 3.2 m at a slant of at most 50 degrees, if nothing
stands between, and never otherwise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from robbie_robots.workers.numbers.mission import NumbersMission
from robbie_robots.workers.numbers.mission_states import NumbersSettings, NumbersState
from robbie_robots.workers.numbers.mission_targets import SignReport
from robbie_robots.workers.numbers.sign_map import SignMap
from robbie_robots.workers.numbers.sign_placing import SignView

RESOLUTION_M, WIDTH, HEIGHT = 0.1, 130, 100
READ_M, READ_RAD = (1.6, 3.2), math.radians(50)
HALF_WIDTH_RAD = math.radians(30)
STEP_S = 0.5


@dataclass(frozen=True)
class Board:
    digit: int | None
    x_m: float
    y_m: float
    facing_rad: float


class Ground:
    """A walled ground of 13 m x 10 m. `hidden` are pillars (x, y, radius)."""

    def __init__(self, boards: Sequence[Board], pillars: Sequence[tuple[float, float, float]] = ()) -> None:
        self.boards = boards
        self.now_s = 0.0
        self.images = 0
        self.signs = SignMap()
        self.pose = np.array([6.5, 5.0, 0.0])
        self.cells = np.zeros((HEIGHT, WIDTH), np.int8)
        self.cells[[0, -1]] = self.cells[:, [0, -1]] = 100
        row, column = np.indices(self.cells.shape)
        for x, y, radius in pillars:
            around = np.hypot((column + 0.5) * RESOLUTION_M - x, (row + 0.5) * RESOLUTION_M - y)
            self.cells[around <= radius] = 100
        places = [(board.x_m, board.y_m) for board in boards]
        for x, y in places:
            self.cells[int(y / RESOLUTION_M), int(x / RESOLUTION_M)] = 100
        self.solid = (np.argwhere(self.cells == 100)[:, ::-1].astype(np.float64) + 0.5) * RESOLUTION_M
        self.signs.see_posts(np.array(places))
        self.mission = NumbersMission(lambda: self.now_s, NumbersSettings(sheet_images=2))
        self.mission.see_stopped(None)
        self.mission.see_map(self.cells, RESOLUTION_M, (0.0, 0.0))

    def look(self, at_xy_m: tuple[float, float]) -> None:
        eye = (*self.pose[:2].tolist(), math.atan2(at_xy_m[1] - self.pose[1], at_xy_m[0] - self.pose[0]))
        view = SignView(eye, HALF_WIDTH_RAD, self.solid)
        for sign in self.signs.signs:
            if view.shows(sign.xy_m, *READ_M):
                self.signs.look(sign, eye)
        for board in self.boards:
            place = (board.x_m, board.y_m)
            slant = math.atan2(eye[1] - board.y_m, eye[0] - board.x_m) - board.facing_rad
            if abs(math.remainder(slant, math.tau)) <= READ_RAD and view.shows(place, *READ_M):
                if board.digit is None:
                    self.signs.see_other(place, eye, 60.0, 1.0)
                else:
                    self.signs.see(str(board.digit), place, board.facing_rad, eye, 60.0)

    def step(self) -> None:
        self.now_s += STEP_S
        self.images += 1
        self.mission.see_pose(self.pose)
        reports = [
            SignReport(
                (float(sign.xy_m[0]), float(sign.xy_m[1])),
                sign.facing_rad,
                int(sign.text) if sign.text else None,
                sign.is_open,
                sign.searched,
                int(sign.likely) if sign.likely else None,
                sign.times(sign.likely),
            )
            for sign in self.signs.signs
        ]
        self.mission.see_signs(reports, "", self.images)
        orders = self.mission.step()
        if orders.goal is not None:
            self.drive(orders.goal)
        if orders.look_at_xy_m is not None:
            self.look(orders.look_at_xy_m)

    def drive(self, goal: np.ndarray) -> None:
        """Drive at most 0.5 m towards a goal; obstacles are only the mission's concern."""
        ahead = goal[:2] - self.pose[:2]
        away_m = float(np.hypot(*ahead))
        if away_m <= 0.5:
            self.pose = goal
            self.mission.arrived()
        else:
            self.pose = np.array([*(self.pose[:2] + 0.5 * ahead / away_m), math.atan2(ahead[1], ahead[0])])

    def play(self, steps: int = 1800) -> None:
        for _ in range(steps):
            if self.mission.machine.is_final:
                return
            self.step()


# As in the random ground of seed 0 (hw/simulation/number_ground.py), from its corner.
BOARDS = [
    Board(0, 5.634, 1.132, 0.725),
    Board(1, 5.197, 9.077, 3.021),
    Board(2, 11.361, 3.834, -1.119),
    Board(3, 3.444, 6.010, -2.614),
    Board(4, 10.226, 7.354, -1.638),
    Board(5, 3.483, 1.327, 0.505),
    Board(6, 3.135, 8.625, -0.848),
    Board(7, 11.793, 8.197, -1.682),
    Board(8, 7.781, 1.133, 1.377),
    Board(9, 1.647, 3.723, -0.438),
    Board(None, 11.720, 5.510, 2.439),
    Board(None, 7.917, 8.764, -0.821),
    Board(None, 5.165, 4.424, 2.994),
    Board(None, 9.588, 3.433, 2.282),
]
PILLARS = [(1.085, 7.569, 0.160), (10.038, 0.922, 0.378), (6.964, 3.358, 0.364)]


def test_every_number_is_found_and_reached_on_a_ground_with_other_boards_and_pillars() -> None:
    ground = Ground(BOARDS, PILLARS)
    ground.play()
    assert ground.mission.reached == list(range(10)), ground.mission.status
    assert ground.now_s < 400.0


@pytest.mark.parametrize("facing_rad", [0.3, 2.0, -2.4])
def test_board_between_pillars_is_read_through_the_one_gap(facing_rad: float) -> None:
    """All places from where it can be read but those in a narrow sector are behind pillars."""
    at = np.array([6.5, 5.0]) + 2.0 * np.array([math.cos(facing_rad + 2.6), math.sin(facing_rad + 2.6)])
    ring = [facing_rad + turn for turn in (-1.9, -1.25, -0.62, 0.62, 1.25, 1.9)]
    pillars = [(at[0] + 1.0 * math.cos(turn), at[1] + 1.0 * math.sin(turn), 0.15) for turn in ring]
    ground = Ground([Board(0, float(at[0]), float(at[1]), facing_rad)], pillars)
    ground.play()
    assert ground.mission.reached[:1] == [0], ground.mission.status


def test_glimpse_of_the_next_number_is_followed_before_other_posts_are_searched() -> None:
    boards = [Board(0, 10.5, 5.0, math.pi), *(Board(None, x, y, 0.0) for x in (2.5, 5.0) for y in (2.5, 7.5))]
    ground = Ground(boards)
    for _ in range(2):
        ground.signs.see("0", (10.5, 5.0), math.pi, (6.5, 5.0), 40.0)
    while ground.mission.state is not NumbersState.REACHED:
        assert ground.now_s < 60.0, ground.mission.status
        ground.step()
    assert ground.pose[0] > 9.0


def test_next_number_read_from_one_place_is_looked_at_from_another_place_before_other_posts() -> None:
    others = [Board(None, x, y, 0.0) for x in (1.5, 4.0, 11.5) for y in (1.5, 8.5)]
    ground = Ground([Board(0, 9.0, 5.0, math.pi), *others])
    number = ground.signs.signs[0]
    while not number.places:
        ground.step()
    began_s = ground.now_s
    while ground.mission.state is not NumbersState.REACHED:
        assert ground.now_s < began_s + 30.0, ground.mission.status
        ground.step()
    assert {place.text for place in number.places} == {"0"}


def test_digit_read_from_one_place_only_is_not_reached_before_a_look_from_another_place() -> None:
    """What looks like a digit from one place may be something else: here, a board with a letter."""
    ground = Ground([Board(None, 10.0, 5.0, math.pi)])
    for _ in range(20):
        ground.signs.see("0", (10.0, 5.0), math.pi, (6.5, 5.0), 40.0)
    ground.play()
    assert ground.mission.reached == []
    assert ground.signs.signs[0].text == ""


def test_search_ends_when_no_post_carries_the_next_number() -> None:
    ground = Ground([Board(None, 9.0, 5.0, math.pi), Board(1, 3.0, 5.0, 0.0)])
    ground.play()
    assert ground.mission.state is NumbersState.DONE
    assert ground.mission.machine.reason == "did not find a way to number 0"
