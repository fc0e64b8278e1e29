"""Runs of "follow me" are judged by what referee, base and task wrote; every seed has a valid apartment."""

import json
from pathlib import Path

import pytest

from robbie_robots.hw.simulation.arena_file import read_arena
from tools.trials.missions.follow import FollowResult, apartment, judge, summary


def judged(folder: Path, *, wrong: int = 0, touches: int = 0, state: str = "FOLLOW") -> FollowResult:
    files = {
        "referee": {
            "near_share": 0.95,
            "task_s": 120.0,
            "wrong_s": 1.5 * wrong,
            "wrong_times": wrong,
            "crossings": 5,
            "farthest_m": 3.2,
        },
        "base": {"touches": touches, "collisions": touches},
        "follow": {"losses": 1, "questions": 0, "state": state},
    }
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    outcome = FollowResult(seed=1)
    judge(outcome, folder)
    return outcome


def test_run_is_right_if_the_right_person_is_followed_and_nobody_touched(tmp_path: Path) -> None:
    right, wrong = judged(tmp_path), judged(tmp_path, wrong=2)
    assert right.is_right and not wrong.is_right
    assert not judged(tmp_path, touches=1).is_right
    assert not judged(tmp_path, state="IDLE").is_right
    total = summary([right, wrong])
    assert (total["runs"], total["is_right"], total["wrong_times"], total["wrong_s"]) == (2, 1, 2, 3.0)
    assert (total["minutes"], total["crossings_per_minute"], total["losses"]) == (4.0, 2.5, 2)


@pytest.mark.parametrize("hurries", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_apartments_are_valid_and_the_people_differ_from_seed_to_seed(
    tmp_path: Path, seed: int, hurries: bool
) -> None:
    (tmp_path / "a.yaml").write_text(apartment(seed, hurries))
    people = read_arena(tmp_path / "a.yaml").people
    assert [person.name for person in people] == ["Anna", "Ben", "Clara", "David"]
    assert len({person.shirt for person in people}) == 4
    assert apartment(seed) == apartment(seed) != apartment(seed + 2)
