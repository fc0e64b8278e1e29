"""Random arenas are valid: closed, completely reachable, and every victim can be viewed."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import WallSpot
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.arena_generator import ArenaWishes, CannotBeArranged
from robbie_robots.hw.simulation.generate_arena import generate_arena, main
from robbie_robots.hw.simulation.reachable_area import reachable_area
from tests._support.places import ARENAS

FULL = ArenaWishes(victims=6, signs=3, obstacles=12, appearing=2)


def arena(tmp_path: Path, text: str) -> Arena:
    (tmp_path / "made.yaml").write_text(text)
    return read_arena(tmp_path / "made.yaml")


def spots_of(there: Arena) -> list[WallSpot]:
    return [*(victim.spot for victim in there.victims), *(sign.spot for sign in there.signs)]


def check_reachable(there: Arena, cell_m: float = 0.05) -> None:
    """A robot that keeps 0.3 m from everything gets wherever there is room for it, and to every victim."""
    area = reachable_area(there, body_radius_m=0.3, resolution_m=cell_m)
    rows, columns = area.free.shape
    grid = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), -1) * cell_m
    roomy = area.free & (there.clearance_m(grid) >= 0.3)
    assert area.drivable.sum() >= 0.99 * roomy.sum()
    for spot in spots_of(there):
        x, y = spot.x_m + 0.8 * math.cos(spot.facing_rad), spot.y_m + 0.8 * math.sin(spot.facing_rad)
        row, column = int(y / cell_m), int(x / cell_m)
        assert area.drivable[row - 1 : row + 2, column - 1 : column + 2].any(), spot
        # Nothing is between: a ray from there ends at the spot.
        assert there.ranges_m(x, y, np.array([spot.facing_rad + math.pi]))[0] == pytest.approx(0.8, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_arena_has_the_wanted_contents_and_all_is_reachable(seed: int, tmp_path: Path) -> None:
    made = arena(tmp_path, generate_arena(seed, FULL))
    assert (made.width_m, made.height_m) == (10.0, 8.0)
    assert (len(made.victims), len(made.signs), len(made.appearing)) == (6, 3, 2)
    spots = np.array([(spot.x_m, spot.y_m) for spot in spots_of(made)])
    apart = np.hypot(*(spots[:, None] - spots[None]).transpose(2, 0, 1)) + 9 * np.eye(len(spots))
    assert apart.min() > 1.0
    assert made.clearance_m(np.array(made.start[:2])) > 0.35
    assert len(made.circles) + len(made.segments) > 20
    check_reachable(made)


@pytest.mark.parametrize("name", ["rescue_maze", "office", "hall"])
def test_everything_in_the_stock_arenas_is_reachable(name: str) -> None:
    there = read_arena(ARENAS / f"{name}.yaml")
    assert len(there.victims) >= 5 and len(there.signs) >= 2
    check_reachable(there, 0.1)


def test_arena_depends_only_on_the_seed() -> None:
    assert generate_arena(3) == generate_arena(3) != generate_arena(4)


def test_reachable_area_of_a_room_is_correct(tmp_path: Path) -> None:
    room = arena(tmp_path, "cell_m: 1\ndrawing: |\n  ######\n  #R..##\n  ######\n")
    area = reachable_area(room, body_radius_m=0.2)
    assert area.free_m2 == pytest.approx(3.0, abs=0.01)
    assert area.drivable_m2 == pytest.approx(2.6 * 0.6, rel=0.05)
    assert not area.drivable[:, 80:].any()


@pytest.mark.parametrize(
    "wishes", [ArenaWishes(width_m=1.0), ArenaWishes(victims=51), ArenaWishes(3.0, 3.0, victims=30)]
)
def test_wish_that_cannot_be_met_is_refused(wishes: ArenaWishes) -> None:
    with pytest.raises(CannotBeArranged):
        generate_arena(0, wishes)


def test_command_writes_the_arena_or_reports_the_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seed", "3", "--victims", "2", "--width_m", "9"]) == 0
    assert capsys.readouterr().out == generate_arena(3, ArenaWishes(width_m=9.0, victims=2))
    with pytest.raises(SystemExit, match="2"):
        main(["--seed", "3", "--victims", "51"])
    assert "at most 50 victims" in capsys.readouterr().err
