"""Random grounds have all digits, each with free space in front; the referee judges visits to them."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.number_ground import FRONTS_M, generate_ground, main
from robbie_robots.hw.simulation.number_referee import Visit, judge, wanted_order


def ground(tmp_path: Path, seed: int, *, sheet: bool = False) -> Arena:
    file = tmp_path / "ground.yaml"
    file.write_text(generate_ground(seed, sheet=sheet))
    return read_arena(file)


@pytest.mark.parametrize("seed", range(8))
def test_every_digit_stands_once_with_free_space_in_front(tmp_path: Path, seed: int) -> None:
    arena = ground(tmp_path, seed)
    digits = [sign.digit for sign in arena.numbers if sign.digit is not None]
    assert sorted(digits) == list(range(10))
    assert len(arena.numbers) == 14
    for sign in arena.numbers:
        for away_m in FRONTS_M:
            x = sign.x_m + away_m * math.cos(sign.facing_rad)
            y = sign.y_m + away_m * math.sin(sign.facing_rad)
            assert arena.clearance_m(np.array([x, y])) > 0.5


def test_seed_makes_the_same_ground_and_another_seed_another_one() -> None:
    assert generate_ground(3) == generate_ground(3)
    assert generate_ground(3) != generate_ground(4)


def test_sheet_shows_every_digit_in_front_of_the_robot(tmp_path: Path) -> None:
    arena = ground(tmp_path, 5, sheet=True)
    assert arena.sheet is not None
    assert sorted(arena.sheet.text) == list("0123456789")
    ahead = arena.start.plus(Pose(1.5, 0.0, 0.0))
    assert math.dist(ahead[:2], (arena.sheet.spot.x_m, arena.sheet.spot.y_m)) < 0.01
    assert wanted_order(arena) == [int(digit) for digit in arena.sheet.text]


def test_command_writes_a_ground(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seed", "3"]) == 0
    assert capsys.readouterr().out == generate_ground(3)


def at(arena: Arena, digit: int, away_m: float, beside_rad: float = 0.0) -> Pose:
    """A pose in front of a digit."""
    [sign] = [sign for sign in arena.numbers if sign.digit == digit]
    angle = sign.facing_rad + beside_rad
    return Pose(sign.x_m + away_m * math.cos(angle), sign.y_m + away_m * math.sin(angle), 0.0)


def test_visits_count_in_order_near_and_in_front(tmp_path: Path) -> None:
    arena = ground(tmp_path, 1)
    visits: list[Visit] = []
    for digit in range(10):
        visits.append(judge(arena, visits, digit, at(arena, digit, 1.0, 0.5), float(digit)))
        assert visits[-1].counts
    assert not judge(arena, visits, 0, at(arena, 0, 1.0), 11.0).counts


def test_visits_that_are_far_beside_or_out_of_order_do_not_count(tmp_path: Path) -> None:
    arena = ground(tmp_path, 1)
    assert not judge(arena, [], 0, at(arena, 0, 1.6), 0.0).counts
    assert not judge(arena, [], 0, at(arena, 0, 1.0, 1.2), 0.0).counts
    assert not judge(arena, [], 1, at(arena, 1, 1.0), 0.0).counts
    assert not judge(arena, [], 0, at(arena, 1, 1.0), 0.0).counts
