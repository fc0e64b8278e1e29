"""The rescue robot, run as a user runs it: in a small room, in lockstep, judged by the ground truth."""

import csv
import json
import math

import pytest

from robbie_robots.hw.simulation.arena_file import read_arena
from tests._support.places import ARENAS
from tests.robot._support.stock_robot import StockRobot
from tools.trials.missions.rescue import RescueResult, judge

# The time of the mission is simulated, but that of the machine is not; on a busy one it takes its time.
pytestmark = [pytest.mark.every_turn, pytest.mark.timeout(400)]


def test_small_mission_finds_all_victims_maps_everything_and_comes_home(robot: StockRobot) -> None:
    exit_code, modules, errors = robot.run("rescue-small", timeout_s=380.0)
    assert exit_code == 0, errors
    assert {module["restarts"] for module in modules.values()} == {0}
    arena = read_arena(ARENAS / "rescue_small.yaml")
    outcome = RescueResult(seed=0, victims=len(arena.victims))
    judge(outcome, arena, robot.output)
    assert outcome.is_home, outcome.reason
    assert outcome.found == outcome.victims == 2, outcome.placed_m
    assert outcome.invented == outcome.collisions == 0
    assert outcome.mapped >= 0.95
    assert outcome.simulated_s < 120.0
    with (robot.output / "rescue_victims.csv").open(newline="") as file:
        assert {row["name"] for row in csv.DictReader(file)} == {"tag 11", "tag 12"}
    figures = json.loads((robot.output / "mission.json").read_text())
    assert figures["notes"] == []
    assert math.isclose(figures["duration_s"], outcome.simulated_s, abs_tol=0.1)
    assert (robot.output / "rescue_map.png").exists()
