"""The trials of "who is who": the guests' apartment, and the judgement by the truth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.people import read_heads
from tools.trials.missions.who_is_who import TourResult, judge, party, summary


def person(name: str, x_m: float, y_m: float = 0.0) -> dict[str, Any]:
    return {"name": name, "x_m": x_m, "y_m": y_m, "faces": 3}


def judged(folder: Path, found: list[dict[str, Any]], touches: int = 0) -> TourResult:
    truth = [person("Anna", 1.0), person("Ben", 4.0), person("Clara", 7.0)]
    told = {"found": found, "truth": truth, "known": ["Anna", "Ben"], "duration_s": 40.0}
    (folder / "guests.json").write_text(json.dumps(told))
    (folder / "base.json").write_text(json.dumps({"touches": touches}))
    outcome = TourResult(0)
    judge(outcome, ["Anna", "Ben"], folder)
    return outcome


@pytest.mark.parametrize("seed", range(6))
def test_guests_have_pictures_and_ways_through_the_apartment(seed: int, tmp_path: Path) -> None:
    pictures = {name: [np.zeros((30, 20, 3), np.uint8)] * 2 for name in ("Anna", "Ben", "Clara", "David")}
    text, introduced = party(seed, pictures, tmp_path / "faces")
    (tmp_path / "arena.yaml").write_text(text)
    people = [one.name for one in read_arena(tmp_path / "arena.yaml").people]
    assert introduced == people[:2]
    assert {
        name: len(heads) for name, heads in read_heads(tmp_path / "faces", people).items()
    } == dict.fromkeys(people, 2)


def test_all_found_is_right_unless_somebody_was_touched(tmp_path: Path) -> None:
    found = [person("Anna", 1.2), person("Ben", 4.0, 0.9), person("", 7.0)]
    assert judged(tmp_path, found).is_right
    assert not judged(tmp_path, found, touches=1).is_right


def test_false_names_missed_guests_and_ghosts_are_counted(tmp_path: Path) -> None:
    found = [person("", 1.0), person("Anna", 7.2), person("Ben", 9.5)]
    outcome = judged(tmp_path, found)
    assert not outcome.is_right
    assert (outcome.named, outcome.false_names, outcome.unknown_right) == (0, 1, 0)
    assert (outcome.missed, outcome.ghosts) == (1, 1)
    figures = summary([outcome, judged(tmp_path, [person("Anna", 1), person("Ben", 4), person("", 7)])])
    assert (figures["is_right"], figures["false_rejects"]) == (1, 0.5)
    assert figures["false_accepts"] == pytest.approx(1 / 6, abs=0.001)
