"""Rescue missions in random arenas, judged by the ground truth.

    python -m tools.trials rescue --seeds 20 --json FILE [--kill] [--profile rescue-fast]

Each seed makes an arena (`hw.simulation.generate_arena`). The profile runs in it until its mission has ended.
With `--kill` the tool kills every module once, at a random moment of the mission. In lockstep, as in the
profile `rescue-fast`, the robot waits for a restarting module. To see what a death does to a robot that
drives on meanwhile, use `--profile rescue`, which runs at real-time speed.
"""

import argparse
import csv
import json
import math
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.arena_generator import ArenaWishes
from robbie_robots.hw.simulation.generate_arena import generate_arena
from robbie_robots.hw.simulation.reachable_area import reachable_area
from robbie_robots.workers.maps.map_file import read_map
from robbie_robots.workers.planar_pose import relative, transform_points
from tools.trials.harness import Case
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, all_in_order, mean, totals

NOISY = ("base", "laser", "camera", "base_emulator", "laser_emulator")
PLACED_M, HOME_M = 0.2, 0.5
WISHES = ArenaWishes(width_m=8.0, height_m=6.0, victims=4, signs=2, obstacles=6)
RUN_LIMIT_S = 900.0
BEGIN_S, KILL_END_S = 5.0, 120.0
"""The tool kills modules in this part of the mission, if the mission is long enough."""


@dataclass
class RescueResult(MissionTrial):
    """The result of one mission, by the ground truth.

    Attributes:
        mapped: share of the reachable area that is on the map.
        victims: number of victims in the arena.
        found: number of victims that the robot confirmed and placed within 0.2 m.
        placed_m: distance of each confirmed victim from the true one.
        invented: number of confirmed victims that do not exist.
        collisions: number of collisions of the robot.
        from_start_m: distance from the start at the end.
        is_home: whether the robot returned to the start in time.
        simulated_s: duration of the mission in simulated time.
    """

    mapped: float = 0.0
    victims: int = 0
    found: int = 0
    placed_m: dict[int, float] = field(default_factory=dict)
    invented: int = 0
    collisions: int = 0
    from_start_m: float = math.inf
    is_home: bool = False
    reason: str = ""
    simulated_s: float = 0.0


def set_up(outcome: RescueResult, case: Case) -> Setup:
    """Make the arena of a seed."""
    file = case.folder / "arena.yaml"
    file.write_text(generate_arena(case.seed, replace(WISHES, appearing=case.options.appearing)))
    arena = read_arena(file)
    outcome.victims = len(arena.victims)
    # The profile of the page goes on after its mission, and this would wait for its end.
    return Setup(file, partial(judge, outcome, arena), settings=["mission.goes_on=false"])


def judge(outcome: RescueResult, arena: Arena, output: Path) -> None:
    """Compare the results of a mission with the ground truth."""
    mission = json.loads((output / "mission.json").read_text())
    base = json.loads((output / "base.json").read_text())
    outcome.reason = "; ".join([mission["reason"], *mission["notes"]])
    outcome.simulated_s = round(mission["duration_s"], 1)
    outcome.collisions = base["collisions"]
    outcome.from_start_m = round(base["from_start_m"], 3)
    outcome.is_home = mission["reason"] == "is home" and outcome.from_start_m <= HOME_M
    outcome.mapped = round(mapped_share(arena, output / "map.yaml"), 4)
    true_places = {victim.tag: _in_map(arena, victim.spot.x_m, victim.spot.y_m) for victim in arena.victims}
    heights = {victim.tag: victim.spot.height_m for victim in arena.victims}
    with (output / "rescue_victims.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["confirmed"] == "yes"]
    for row in rows:
        tag = int(row["id"])
        if tag not in true_places:
            outcome.invented += 1
            continue
        true_place = (*true_places[tag], heights[tag])
        away_m = math.dist((float(row["x"]), float(row["y"]), float(row["z"])), true_place)
        outcome.placed_m[tag] = round(away_m, 3)
    outcome.found = sum(away_m <= PLACED_M for away_m in outcome.placed_m.values())


def _in_map(arena: Arena, x_m: float, y_m: float) -> tuple[float, float]:
    """Transform a place from the arena's frame into the map's, whose origin is the robot's start."""
    x, y, _ = relative(arena.start, (x_m, y_m, 0.0)).tolist()
    return x, y


def mapped_share(arena: Arena, map_file: Path) -> float:
    """Return the share of the reachable area that a map knows."""
    area = reachable_area(arena)
    made = read_map(map_file)
    rows, columns = np.nonzero(area.free)
    places = (np.stack([columns, rows], axis=1) + 0.5) * area.resolution_m
    start = np.array(arena.start)
    in_map = transform_points(relative(start, np.zeros(3)), places)
    column, row = np.floor((in_map - made.corner_xy_m) / made.resolution_m).astype(int).T
    inside = (row >= 0) & (row < made.cells.shape[0]) & (column >= 0) & (column < made.cells.shape[1])
    known = made.cells[np.where(inside, row, 0), np.where(inside, column, 0)] >= 0
    return float((inside & known).mean())


def summary(outcomes: list[RescueResult]) -> dict[str, Any]:
    """Return the figures of all missions together."""
    placed = [away_m for outcome in outcomes for away_m in outcome.placed_m.values()]
    sums = totals(outcomes, "victims", "found", "invented", "collisions", "is_home")
    return {
        "missions": len(outcomes),
        "mapped_mean": mean(outcomes, "mapped", 4),
        "mapped_least": min(outcome.mapped for outcome in outcomes),
        "found_share": round(sums["found"] / max(sums["victims"], 1), 4),
        "placed_median_m": round(float(np.median(placed)), 3) if placed else None,
        "placed_worst_m": max(placed, default=None),
        "simulated_s_mean": mean(outcomes, "simulated_s"),
        **sums,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of rescue missions."""
    text = "number of obstacles that appear and disappear in each arena"
    parser.add_argument("--appearing", type=int, default=0, help=text)


SUBJECT = SeededMission(
    outcome=RescueResult,
    set_up=set_up,
    profile="rescue-fast",
    noisy=NOISY,
    limit_s=RUN_LIMIT_S,
    kills_s=(BEGIN_S, KILL_END_S),
    more_options=options,
    summary=summary,
    is_good=all_in_order,
    results="missions",
    seed_makes="an arena",
).subject
