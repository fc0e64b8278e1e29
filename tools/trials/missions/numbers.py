"""Drives to numbered signs on random grounds, judged by the ground truth.

    python -m tools.trials numbers --seeds 20 [--kill] [--sheet] [--ground FILE] [--profile NAME]

Each seed makes a ground (`hw.simulation.number_ground`). With `--sheet`, a sheet at the start shows a random
order; otherwise it is ascending. A seed is right if the robot visited all ten signs in this order, stood at
most 1.5 m in front of each, and touched nothing. With `--kill`, the tool kills every module once, at a random
moment; in lockstep, as in the profile `numbers-fast`, the robot waits for a restarting module. With
`--ground`, every seed plays on one ground, with other noise and other kills.
"""

import argparse
import json
import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.number_ground import generate_ground
from tools.trials.harness import Case
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, mean, totals

NOISY = ("base", "laser", "camera")
SAME_M = 0.6


@dataclass
class GroundResult(MissionTrial):
    """The result of one ground, by the ground truth.

    Attributes:
        right: number of visits that count.
        wrong: number of other visits.
        is_right: whether all signs were visited in order and nothing was touched.
        farthest_m: largest distance from a sign at a visit that counts.
        most_beside_deg: largest angle beside the front of a sign at a visit that counts; 60 is too much.
        touches: number of collisions.
        wrong_visits: those visits, in words.
        signs: number of signs whose digit the robot believed in the end.
        false_signs: those that carry something else, in words.
        reason: why the task ended.
        simulated_s: duration of the task in simulated time.
    """

    sheet: bool = False
    right: int = 0
    wrong: int = 0
    is_right: bool = False
    farthest_m: float = 0.0
    most_beside_deg: float = 0.0
    touches: int = 0
    wrong_visits: list[str] = field(default_factory=list)
    signs: int = 0
    false_signs: list[str] = field(default_factory=list)
    reason: str = ""
    simulated_s: float = 0.0


def set_up(outcome: GroundResult, case: Case) -> Setup:
    """Make the ground of a seed, unless the command line names one."""
    file = case.options.ground or case.folder / "ground.yaml"
    if case.options.ground is None:
        file.write_text(generate_ground(case.seed, sheet=case.options.sheet))
    outcome.sheet = read_arena(file).sheet is not None
    return Setup(file, partial(judge_with_signs, outcome, file))


def judge_with_signs(outcome: GroundResult, file: Path, output: Path) -> None:
    """Judge visits, touches, and what the robot believes of the signs of a ground."""
    judge(outcome, output)
    believed = json.loads((output / "numbers.json").read_text())["signs"]
    outcome.signs, outcome.false_signs = len(believed), false_signs(believed, read_arena(file))


def judge(outcome: GroundResult, output: Path) -> None:
    """Take the referee's judgement and the base's collisions."""
    referee = json.loads((output / "referee.json").read_text())
    task = json.loads((output / "numbers.json").read_text())
    right = [visit for visit in referee["visits"] if visit["counts"]]
    outcome.right, outcome.wrong = len(right), len(referee["visits"]) - len(right)
    outcome.wrong_visits = [
        f"{visit['digit']}: {visit['distance_m']:.2f} m away, {_beside_deg(visit):.0f}° beside, "
        f"{'' if visit['is_in_order'] else 'not '}in order"
        for visit in referee["visits"]
        if not visit["counts"]
    ]
    outcome.most_beside_deg = round(max(map(_beside_deg, right), default=0.0), 1)
    outcome.farthest_m = round(max((visit["distance_m"] for visit in right), default=0.0), 3)
    outcome.touches = json.loads((output / "base.json").read_text())["collisions"]
    outcome.is_right = referee["is_right"] and not outcome.touches
    outcome.reason, outcome.simulated_s = task["reason"], round(task["used_s"], 1)


def _beside_deg(visit: dict[str, Any]) -> float:
    return abs(math.degrees(visit["aside_rad"]))


def false_signs(believed: list[dict[str, Any]], arena: Arena) -> list[str]:
    """Return which believed signs (digit, x_m and y_m in the map frame) are none, in words.

    The map's frame is where the robot started.
    """
    found = []
    for sign in believed:
        place = arena.start.plus(Pose(sign["x_m"], sign["y_m"], 0.0))
        away_m, board = min(
            (math.dist(place[:2], (board.x_m, board.y_m)), board.text) for board in arena.numbers
        )
        if away_m > SAME_M:
            found.append(f"nothing as {sign['digit']}")
        elif board != str(sign["digit"]):
            found.append(f"{board} as {sign['digit']}")
    return found


def summary(outcomes: list[GroundResult]) -> dict[str, Any]:
    """Return the figures of all grounds together."""
    return {
        "grounds": len(outcomes),
        "farthest_m": max(outcome.farthest_m for outcome in outcomes),
        "simulated_s_mean": mean(outcomes, "simulated_s"),
        **totals(outcomes, "is_right", "wrong", "touches", "signs"),
        "false_signs": [text for outcome in outcomes for text in outcome.false_signs],
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of grounds."""
    parser.add_argument("--ground", type=Path, metavar="FILE", help="play on this ground only")
    parser.add_argument("--sheet", action="store_true", help="a sheet at the start shows the order")


SUBJECT = SeededMission(
    outcome=GroundResult,
    set_up=set_up,
    profile="numbers-fast",
    noisy=NOISY,
    limit_s=2400.0,
    kills_s=(2.0, 150.0),
    more_options=options,
    summary=summary,
    results="grounds",
    seed_makes="a ground",
).subject
