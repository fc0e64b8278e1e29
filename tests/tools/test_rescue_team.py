"""The robots of a team get settings that fit together."""

import json
import math
from pathlib import Path

import numpy as np

from robbie_mp.run.profile.load import load_profile
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.workers.planar_pose import compose
from tests._support.places import ARENAS
from tools.robot import REPOSITORY
from tools.trials.missions.rescue import RescueResult
from tools.trials.missions.rescue_team import (
    PROFILE,
    SIMULATED,
    TeamOutcome,
    arguments_of,
    compare,
    second_start,
    sum_up,
)


def test_second_robot_starts_beside_the_first_on_free_ground() -> None:
    arena = read_arena(ARENAS / "rescue_maze.yaml")
    start = second_start(arena)
    assert 0.8 <= math.dist(start[:2], arena.start[:2]) <= 1.2
    assert arena.clearance_m(np.array([start[:2]]))[0] > 0.3
    assert start.heading_rad == arena.start.heading_rad


def test_each_robot_knows_the_other_and_only_known_modules_get_settings(tmp_path: Path) -> None:
    arena = read_arena(ARENAS / "rescue_maze.yaml")
    starts = {"red": arena.start, "blue": second_start(arena)}
    modules = {spec.name: spec for spec in load_profile(PROFILE, REPOSITORY).modules}
    for robot, other in (("red", "blue"), ("blue", "red")):
        profile, *words = arguments_of(robot, starts, 3, tmp_path, 7447)
        settings = dict(word.split("=", 1) for word in words[1::2])
        assert profile == PROFILE
        assert {name.split(".")[0] for name in settings} <= set(modules)
        assert json.loads(settings["mission.team"]) == [other]
        assert json.loads(settings["mission.gives_way_to"]) == ([] if robot == "red" else ["red"])
        known = json.loads(settings["map_merger.starts"])[other]
        assert math.dist(compose(starts[robot], known)[:2], starts[other][:2]) < 1e-9
    assert settings["link.listen"] == "[]"


def test_victim_counts_once_and_only_where_it_was_placed() -> None:
    team = TeamOutcome(0, victims=3)
    team.robots["red"] = RescueResult(0, placed_m={1: 0.1, 2: 0.5}, collisions=1, simulated_s=50.0)
    team.robots["blue"] = RescueResult(0, placed_m={1: 0.05, 3: 0.01}, simulated_s=60.0)
    sum_up(team)
    assert (team.found, team.collisions, team.simulated_s) == (2, 1, 60.0)


def test_robot_alone_has_the_same_profile_and_no_team(tmp_path: Path) -> None:
    arena = read_arena(ARENAS / "rescue_maze.yaml")
    profile, *words = arguments_of("red", {"red": arena.start}, 3, tmp_path, 7447, rate=0.5)
    settings = dict(word.split("=", 1) for word in words[1::2])
    assert (profile, settings["time.rate"], settings["mission.team"]) == (SIMULATED, "0.5", "[]")


def test_team_is_compared_with_one_robot_in_the_same_arena() -> None:
    team, alone = TeamOutcome(0, simulated_s=60.0), TeamOutcome(0)
    alone.robots["red"] = RescueResult(0, simulated_s=100.0)
    compare(team, alone)
    assert (team.ratio, team.alone) == (0.6, alone.robots["red"])


def test_robots_of_a_team_share_one_simulated_time(tmp_path: Path) -> None:
    arena = read_arena(ARENAS / "rescue_maze.yaml")
    starts = {"red": arena.start, "blue": second_start(arena)}
    shared = []
    for robot in starts:
        _, *words = arguments_of(robot, starts, 3, tmp_path, 7447, rate=10.0)
        settings = dict(word.split("=", 1) for word in words[1::2])
        shared.append((settings["time.shared"], settings["time.waits_for"]))
    assert shared == [(json.dumps(str(tmp_path / "time")), "2")] * 2
