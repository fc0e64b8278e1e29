"""Orders are judged by where the objects truly are, not by what the robot says."""

import json
from pathlib import Path

from tools.trials.missions.grasp import GraspResult, judge, summary


def judged(folder: Path, *, on: str = "counter", lies: bool = False, contacts: int = 0) -> GraspResult:
    objects = {"soup": {"on": on, "lies": lies}, "tea": {"on": "counter", "lies": False}}
    ends = [
        {"object": name, "place": "counter", "is_done": True, "reason": "done", "duration_s": 30.02}
        for name in objects
    ]
    files = {
        "arm": {"objects": objects, "slips": 0, "contacts": contacts},
        "household": ends,
        "base": {"collisions": 0},
    }
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    outcome = GraspResult(seed=1)
    judge(outcome, folder)
    return outcome


def test_room_is_right_if_all_objects_stand_where_they_should_and_nothing_was_touched(tmp_path: Path) -> None:
    outcome = judged(tmp_path)
    assert (outcome.is_right, outcome.right, outcome.orders) == (True, 2, 2)
    assert outcome.simulated_s == 60.0


def test_object_elsewhere_or_fallen_or_a_contact_spoils_a_room(tmp_path: Path) -> None:
    outcomes = [judged(tmp_path, on="floor"), judged(tmp_path, lies=True), judged(tmp_path, contacts=1)]
    assert [(outcome.is_right, outcome.right) for outcome in outcomes] == [(False, 1), (False, 1), (False, 2)]
    total = summary([*outcomes, judged(tmp_path)])
    assert (total["rooms"], total["is_right"], total["right"]) == (4, 1, 6)
    assert (total["fallen"], total["contacts"]) == (1, 1)
