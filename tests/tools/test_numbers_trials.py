"""Runs to numbered signs are judged by what the referee and the simulated base have written."""

import json
from pathlib import Path

from robbie_robots.hw.simulation.arena_file import read_arena
from tests._support.places import ARENAS
from tools.trials.missions.numbers import GroundResult, false_signs, judge, summary


def judged(folder: Path, *, collisions: int = 0, is_right: bool = True) -> GroundResult:
    more = {"aside_rad": 0.5, "is_in_order": True}
    visits = [
        {"digit": 3, "distance_m": 0.8, "counts": True, **more},
        {"digit": 7, "distance_m": 1.1, "counts": is_right, **more},
    ]
    files = {
        "referee": {"visits": visits, "is_right": is_right},
        "numbers": {"reason": "has reached all numbers", "used_s": 200.04},
        "base": {"collisions": collisions},
    }
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    outcome = GroundResult(seed=1, sheet=False)
    judge(outcome, folder)
    return outcome


def test_ground_is_right_if_all_visits_count_and_nothing_was_touched(tmp_path: Path) -> None:
    outcome = judged(tmp_path)
    assert (outcome.is_right, outcome.right, outcome.wrong) == (True, 2, 0)
    assert (outcome.farthest_m, outcome.simulated_s) == (1.1, 200.0)


def test_touch_or_wrong_visit_spoils_a_ground(tmp_path: Path) -> None:
    touching, wrong = judged(tmp_path, collisions=1), judged(tmp_path, is_right=False)
    assert not touching.is_right
    assert (wrong.is_right, wrong.right, wrong.wrong, wrong.farthest_m) == (False, 1, 1, 0.8)
    assert wrong.wrong_visits == ["7: 1.10 m away, 29° beside, in order"]
    total = summary([touching, wrong, judged(tmp_path)])
    assert (total["grounds"], total["is_right"], total["touches"], total["wrong"]) == (3, 1, 1, 1)


def test_believed_digit_is_false_where_the_ground_has_another_board_or_none() -> None:
    """The robot starts at (3.5, 3.5); there are 7, 4, 1 and A."""
    arena = read_arena(ARENAS / "numbers_small.yaml")
    right = {"digit": 4, "x_m": 3.1, "y_m": 2.2}
    false = [{"digit": 4, "x_m": -1.5, "y_m": -1.6}, {"digit": 1, "x_m": 0.0, "y_m": 0.0}]
    assert false_signs([right], arena) == []
    assert false_signs([right, *false], arena) == ["A as 4", "nothing as 1"]
