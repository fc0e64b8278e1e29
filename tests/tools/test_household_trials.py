"""The household's orders are judged by where objects and robot truly are, not by what the robot says."""

import json
from pathlib import Path

import pytest

from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.workers.maps.map_annotations import AnnotatedMap, Annotations
from tools.trials.missions.household import TASKS, OrderResult, apartment, judge, plan_of, summary


def outcome_of(folder: Path, task: str, *, on: str, is_done: bool = True, lies: bool = False) -> OrderResult:
    outcome = OrderResult(seed=3, task=task)
    plan = plan_of(task, 3, apartment(3)[1])
    objects = {name: {"on": on, "lies": lies} for name in ("soup", "tea", "cola")}
    ends = [{"is_done": is_done, "reason": "there", "duration_s": 20.0}]
    files = {
        "arm": {"objects": objects, "contacts": 0},
        "base": {"collisions": 0},
        "household": ends,
    }
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    judge(outcome, plan, folder)
    return outcome


@pytest.mark.parametrize("seed", range(5))
def test_each_seed_makes_an_apartment_and_an_order_of_each_task_that_is_not_done_yet(
    seed: int, tmp_path: Path
) -> None:
    text, on = apartment(seed)
    (tmp_path / "apartment.yaml").write_text(text)
    arena = read_arena(tmp_path / "apartment.yaml")
    tables = {table.name: table for table in arena.tables}
    assert all(tables[on[one.name]].is_below(one.x_m, one.y_m, 0.05) for one in arena.objects)
    for task in TASKS:
        wanted = plan_of(task, seed, on).wanted
        assert all(on[name] != place for name, place in wanted.items())


def test_object_must_be_where_it_should_and_nothing_may_have_fallen(tmp_path: Path) -> None:
    assert outcome_of(tmp_path, "bring", on="person").is_right
    assert not outcome_of(tmp_path, "bring", on="floor").is_right
    assert not outcome_of(tmp_path, "bring", on="person", is_done=False).is_right
    assert not outcome_of(tmp_path, "bring", on="person", lies=True).is_right


@pytest.mark.parametrize(("stands_m", "is_right"), [(5.8, True), (2.0, False)])
def test_robot_must_truly_come_back_to_the_place_that_it_has_learnt(
    stands_m: float, is_right: bool, tmp_path: Path
) -> None:
    kitchen = (5.9, -1.7, 0.0)
    places = Annotations(places={"kitchen": kitchen, "sofa": kitchen})
    (tmp_path / "map.annotations.yaml").write_text(AnnotatedMap(places).as_yaml())
    (tmp_path / "truth.txt").write_text(f"0.0 0.0 0.0 0.0\n60.0 {stands_m} -1.7 0.0\n")
    assert outcome_of(tmp_path, "learn", on="desk").is_right is is_right


def test_summary_counts_each_task() -> None:
    outcomes = [
        OrderResult(1, task="bring", is_right=True, is_done=True, simulated_s=60.0),
        OrderResult(1, task="put", is_done=True, collisions=2),
    ]
    total = summary(outcomes)
    assert (total["orders"], total["right"], total["said_done_but_wrong"]) == (2, 1, 1)
    assert total["tasks"]["bring"] == {"orders": 1, "right": 1, "simulated_s_mean": 60.0}
    assert total["collisions"] == 2
