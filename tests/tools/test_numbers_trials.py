"""Runs to numbered signs are judged by what the referee and the simulated base have written."""

import json
from pathlib import Path

from tools.numbers_trials import Outcome, judge, summary


def judged(folder: Path, *, collisions: int = 0, is_right: bool = True) -> Outcome:
    visits = [{"distance_m": 0.8, "counts": True}, {"distance_m": 1.1, "counts": is_right}]
    files = {
        "referee": {"visits": visits, "is_right": is_right},
        "numbers": {"reason": "has reached all numbers", "used_s": 200.04},
        "base": {"collisions": collisions},
    }
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    outcome = Outcome(seed=1, sheet=False)
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
    total = summary([touching, wrong, judged(tmp_path)])
    assert (total["grounds"], total["right"], total["touches"], total["wrong_visits"]) == (3, 1, 1, 1)
