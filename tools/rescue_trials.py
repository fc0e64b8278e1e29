"""Rescue missions in random arenas, judged by the ground truth.

    python -m tools.rescue_trials --seeds 20 --json FILE [--kill] [--first 0] [--profile rescue-fast]

Each seed makes an arena (`hw.simulation.generate_arena`). The profile runs in it until its mission has ended.
With `--kill` the tool kills every module once, at a random moment of the mission. In lockstep, as in the
profile `rescue-fast`, the robot waits for a restarting module. To see what a death does to a robot that
drives on meanwhile, use `--profile rescue`, which runs at real-time speed.
"""

import csv
import json
import math
import signal
import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hw.simulation.arena import Arena
from hw.simulation.arena_file import read_arena
from hw.simulation.arena_generator import ArenaWishes
from hw.simulation.generate_arena import generate_arena
from hw.simulation.reachable_area import reachable_area
from tools.mission_trials import Trial, command_line, play, play_all, settings_for
from workers.maps.map_file import read_map
from workers.planar_pose import relative, transform_points

NOISY = ("base", "laser", "camera", "base_emulator", "laser_emulator")
PLACED_M, HOME_M = 0.2, 0.5
WISHES = ArenaWishes(width_m=8.0, height_m=6.0, victims=4, signs=2, obstacles=6)
RUN_LIMIT_S = 900.0
BEGIN_S, KILL_END_S = 5.0, 120.0
"""The tool kills modules in this part of the mission, if the mission is long enough."""


@dataclass
class Outcome(Trial):
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


def run_mission(seed: int, folder: Path, profile: str, wishes: ArenaWishes, kill: bool) -> Outcome:
    """Run one mission and judge it."""
    file = folder / "arena.yaml"
    file.write_text(generate_arena(seed, wishes))
    arena = read_arena(file)
    outcome = Outcome(seed, victims=len(arena.victims))
    settings = settings_for(profile, file, seed, NOISY)
    kills_s = (BEGIN_S, KILL_END_S) if kill else None
    judge_it = partial(judge, outcome, arena)
    play(outcome, folder, profile, settings, judge_it, limit_s=RUN_LIMIT_S, kills_s=kills_s)
    return outcome


def judge(outcome: Outcome, arena: Arena, output: Path) -> None:
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


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the figures of all missions together."""
    victims = sum(outcome.victims for outcome in outcomes)
    placed = [away_m for outcome in outcomes for away_m in outcome.placed_m.values()]
    return {
        "missions": len(outcomes),
        "mapped_mean": round(float(np.mean([outcome.mapped for outcome in outcomes])), 4),
        "mapped_least": min(outcome.mapped for outcome in outcomes),
        "victims": victims,
        "found": sum(outcome.found for outcome in outcomes),
        "found_share": round(sum(outcome.found for outcome in outcomes) / max(victims, 1), 4),
        "placed_median_m": round(float(np.median(placed)), 3) if placed else None,
        "placed_worst_m": max(placed, default=None),
        "invented": sum(outcome.invented for outcome in outcomes),
        "collisions": sum(outcome.collisions for outcome in outcomes),
        "home": sum(outcome.is_home for outcome in outcomes),
        "simulated_s_mean": round(float(np.mean([outcome.simulated_s for outcome in outcomes])), 1),
        "trouble": sum(bool(outcome.trouble) for outcome in outcomes),
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. The exit code is 0 if every run ended in order, else 1."""
    parser = command_line("python -m tools.rescue_trials", __doc__, "rescue-fast", "number of arenas")
    parser.add_argument(
        "--appearing", type=int, default=0, help="number of obstacles that appear and disappear in each arena"
    )
    options = parser.parse_args(arguments)
    wishes = replace(WISHES, appearing=options.appearing)

    def play_one(seed: int, folder: Path) -> Outcome:
        return run_mission(seed, folder, options.profile, wishes, options.kill)

    outcomes = play_all(options, play_one, summary, "missions")
    return int(any(outcome.trouble for outcome in outcomes))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
