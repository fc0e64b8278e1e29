"""Missions are judged by the ground truth of their arena."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaVictim, VictimKind, WallSpot
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.workers.maps.map_file import write_map
from tools.trials.missions.rescue import RescueResult, judge, mapped_share, summary

# The robot starts at (1, 2) and looks along y: the map's x axis is the arena's y axis.
ARENA = Arena(
    segments=box_segments(np.array([[0.0, 0.0, 4.0, 3.0]])),
    circles=np.zeros((0, 3)),
    start=Pose(1.0, 2.0, math.pi / 2),
    width_m=4.0,
    height_m=3.0,
    victims=(
        ArenaVictim(5, VictimKind.STILL, WallSpot(4.0, 2.0, 0.35, math.pi)),
        ArenaVictim(6, VictimKind.COLD, WallSpot(2.0, 0.0, 0.35, math.pi / 2)),
    ),
)


def write_known(file: Path, known_x_m: tuple[float, float]) -> None:
    """Write a map that knows the arena between two of the map's x coordinates."""
    cells = np.full((100, 100), -1, np.int8)  # from (-2.5, -3.5) on
    columns = np.arange(100) * 0.05 - 2.5
    cells[:, (columns >= known_x_m[0]) & (columns < known_x_m[1])] = 0
    write_map(file, cells, 0.05, (-2.5, -3.5))


@pytest.mark.parametrize(("known_x_m", "share"), [((-2.5, 2.5), 1.0), ((-0.5, 2.5), 0.5), ((2.0, 2.5), 0.0)])
def test_mapped_share_refers_to_the_reachable_area(
    tmp_path: Path, known_x_m: tuple[float, float], share: float
) -> None:
    write_known(tmp_path / "map.yaml", known_x_m)
    assert mapped_share(ARENA, tmp_path / "map.yaml") == pytest.approx(share, abs=0.03)


def judged(tmp_path: Path, victims: list[tuple[int, float, float, str]], **mission: object) -> RescueResult:
    write_known(tmp_path / "map.yaml", (-2.5, 2.5))
    said = {"reason": "is home", "notes": [], "duration_s": 60.0} | mission
    (tmp_path / "mission.json").write_text(json.dumps(said))
    (tmp_path / "base.json").write_text(json.dumps({"collisions": 2, "from_start_m": 0.1}))
    with (tmp_path / "rescue_victims.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("id", "time", "name", "x", "y", "z", "confirmed"))
        writer.writerows((tag, "", "", x, y, 0.35, confirmed) for tag, x, y, confirmed in victims)
    outcome = RescueResult(seed=0, victims=2)
    judge(outcome, ARENA, tmp_path)
    return outcome


def test_victims_count_only_if_confirmed_and_placed_correctly(tmp_path: Path) -> None:
    outcome = judged(tmp_path, [(5, 0.0, -3.1, "yes"), (6, -2.0, -1.0, "no")])
    assert outcome.placed_m == {5: pytest.approx(0.1)}
    assert (outcome.found, outcome.invented, outcome.collisions) == (1, 0, 2)


def test_victim_in_the_wrong_place_is_not_found_and_a_nonexistent_one_is_invented(
    tmp_path: Path,
) -> None:
    outcome = judged(tmp_path, [(5, 0.0, -2.7, "yes"), (7, 0.0, 0.0, "yes")])
    assert (outcome.found, outcome.invented) == (0, 1)


@pytest.mark.parametrize(("reason", "is_home"), [("is home", True), ("the time is over", False)])
def test_robot_is_home_only_if_it_reports_so_and_stands_there(
    tmp_path: Path, reason: str, is_home: bool
) -> None:
    assert judged(tmp_path, [], reason=reason).is_home is is_home


def test_summary_counts_all_missions() -> None:
    outcomes = [
        RescueResult(0, mapped=1.0, victims=4, found=4, placed_m={1: 0.1}, is_home=True),
        RescueResult(1, mapped=0.9, victims=4, found=2, placed_m={2: 0.3}, collisions=1, trouble="it hung"),
    ]
    total = summary(outcomes)
    assert (total["mapped_mean"], total["found_share"], total["collisions"]) == (0.95, 0.75, 1)
    assert (total["is_home"], total["trouble"], total["placed_worst_m"]) == (1, 1, 0.3)
