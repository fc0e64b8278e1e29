"""Two linked rescue robots explore a random arena together, judged by the ground truth.

    python -m tools.trials rescue_team [--seeds 1] [--rate 10] [--alone] [--kill]

Each robot is a run of the profile `rescue-team`: red starts at the arena's start, blue beside it. They share
the simulated arena by a folder, and talk over a link on this machine alone. Each knows where the other has
started. Where their ways meet, blue gives way. A victim counts as found if one of them has confirmed it and
placed it within 0.2 m.

Both run at real-time speed, which takes two processor cores of their own or more. With `--rate` they share
one simulated time, at most that much faster than real time: neither runs ahead of the other. With `--kill`,
every module of both robots is killed once, their links too, by the robot's own clock. With `--alone`, red
also explores each arena alone, by the same profile, and the figures say how long two robots took compared
with one.
"""

import argparse
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp.run.operator_link import read_link
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.run_directory import list_runs
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.generate_arena import generate_arena
from robbie_robots.hw.simulation.reachable_area import reachable_area
from robbie_robots.workers.planar_pose import relative
from tools.robot import REPOSITORY, Robot, RobotTrouble, free_port
from tools.trials.harness import Case, TrialSubject
from tools.trials.missions.mission import Kills, all_in_order, mean, restarts_in, totals, watch
from tools.trials.missions.rescue import BEGIN_S, NOISY, PLACED_M, RUN_LIMIT_S, WISHES, RescueResult, judge

PROFILE, SIMULATED = "rescue-team", "rescue-team-fast"
KILL_END_S = 60.0
"""By then, every module was killed: the shortest missions of two robots take little longer."""
APART_M = 1.0
FREE_M = 0.35


@dataclass
class TeamOutcome:
    """The result of both robots, by the ground truth.

    Attributes:
        victims: number of victims in the arena.
        found: number of victims that a robot confirmed and placed.
        collisions: collisions of both robots, with walls or one another.
        simulated_s: duration of the longer mission.
        robots: the result of each robot, by its name.
        alone: the result of one robot in the same arena without the other. None: not run.
        ratio: duration compared with that of one robot alone. None: not run.
        trouble: why a run itself failed; '' if none did.
    """

    seed: int
    victims: int = 0
    found: int = 0
    collisions: int = 0
    simulated_s: float = 0.0
    robots: dict[str, RescueResult] = field(default_factory=dict)
    alone: RescueResult | None = None
    ratio: float | None = None
    trouble: str = ""


def second_start(arena: Arena) -> Pose:
    """Return a start for another robot, beside the arena's start and with the same heading."""
    area = reachable_area(arena, FREE_M)
    rows, columns = np.nonzero(area.drivable)
    places = (np.stack([columns, rows], axis=1) + 0.5) * area.resolution_m
    away_m = np.hypot(*(places - arena.start[:2]).T)
    x_m, y_m = places[np.argmin(np.abs(away_m - APART_M))].tolist()
    return Pose(x_m, y_m, arena.start.heading_rad)


def arguments_of(
    robot: str, starts: dict[str, Pose], seed: int, folder: Path, port: int, rate: float | None = None
) -> list[str]:
    """Return the arguments of `robbie run` for one robot of those that start."""
    others = {
        name: relative(starts[robot], start).tolist() for name, start in starts.items() if name != robot
    }
    address = f"tcp/127.0.0.1:{port}"
    is_first = robot == next(iter(starts))
    profile = PROFILE if rate is None else SIMULATED
    settings: dict[str, object] = {
        "link.robot": robot,
        "link.listen": [address] if is_first else [],
        "link.connect": [] if is_first else [address],
        "map_merger.robots": list(others),
        "map_merger.starts": others,
        "mission.team": list(others),
        "mission.gives_way_to": [] if is_first else list(others),
        "base.shared": str(folder / "arena"),
        "laser.shared": str(folder / "arena"),
    }
    if rate is None:
        settings["operator.robot_name"] = robot
    else:
        settings["time.rate"] = rate
        settings["time.shared"] = str(folder / "time")
        settings["time.waits_for"] = len(starts)
    for spec in load_profile(profile, REPOSITORY).modules:
        if spec.name in NOISY:
            settings[f"{spec.name}.seed"] = seed + 1000 * (not is_first)
        if "arena" in spec.settings:
            settings[f"{spec.name}.arena"] = str(folder / "arena.yaml")
            settings[f"{spec.name}.start"] = list(starts[robot])
    if not is_first:
        settings["scene_graph.file"] = "hw/robots/rescue_team_blue.yaml"
    words = [word for name, value in settings.items() for word in ("--set", f"{name}={json.dumps(value)}")]
    return [profile, *words]


def run_team(
    seed: int, folder: Path, rate: float | None = None, *, is_alone: bool = False, kill: bool = False
) -> TeamOutcome:
    """Run both missions, or that of red alone, and judge them."""
    folder.mkdir(parents=True)
    (folder / "arena.yaml").write_text(generate_arena(seed, WISHES))
    arena = read_arena(folder / "arena.yaml")
    starts = {"red": arena.start} if is_alone else {"red": arena.start, "blue": second_start(arena)}
    outcome = TeamOutcome(seed, victims=len(arena.victims))
    port = free_port()
    robots: dict[str, Robot] = {}
    try:
        for name in starts:
            words = arguments_of(name, starts, seed, folder, port, rate)
            robots[name] = Robot(folder / name, REPOSITORY, *words)
        if rate is None:
            print_pages(robots)
        restarts = wait_for_ends(robots, seed if kill else None)
    except RobotTrouble as trouble:
        outcome.trouble = str(trouble)
    finally:
        for robot in robots.values():
            robot.close()
    if not outcome.trouble:
        for name, robot in robots.items():
            one = RescueResult(seed, victims=len(arena.victims))
            one.restarts = restarts[name]
            judge(one, replace(arena, start=starts[name]), robot.output)
            outcome.robots[name] = one
        sum_up(outcome)
    return outcome


def print_pages(robots: dict[str, Robot]) -> None:
    """Print the link to the page of each robot, which has one in real time."""
    for name, robot in robots.items():
        robot.wait_until_running()
        (run,) = list_runs(robot.bases)
        print(f"{name}: {read_link(run.folder)}", flush=True)


def wait_for_ends(robots: dict[str, Robot], kill_seed: int | None = None) -> dict[str, dict[str, int]]:
    """Wait until all missions have ended; return how often modules of each robot were restarted.

    Args:
        robots: by name.
        kill_seed: of the moments at which every module is killed. None: none is.

    Raises:
        RobotTrouble: one has not ended in time, or has failed.
    """
    for robot in robots.values():
        robot.wait_until_running()
    kills = [
        Kills(robot, 100 * kill_seed + index, BEGIN_S, KILL_END_S)
        for index, robot in enumerate(robots.values())
        if kill_seed is not None
    ]
    watch(list(robots.values()), kills, RUN_LIMIT_S)
    return {name: restarts_in(robot.wait_for_end()) for name, robot in robots.items()}


def compare(team: TeamOutcome, alone: TeamOutcome) -> None:
    """Add the result of one robot alone to that of the team."""
    team.trouble = team.trouble or alone.trouble
    if alone.robots:
        team.alone = alone.robots["red"]
        team.ratio = round(team.simulated_s / team.alone.simulated_s, 3)


def sum_up(outcome: TeamOutcome) -> None:
    """Put the results of both robots together."""
    alone = outcome.robots.values()
    outcome.collisions = sum(one.collisions for one in alone)
    outcome.simulated_s = max(one.simulated_s for one in alone)
    placed = {tag for one in alone for tag, away_m in one.placed_m.items() if away_m <= PLACED_M}
    outcome.found = len(placed)


def play(case: Case) -> TeamOutcome:
    """Run both robots in the arena of a seed, and perhaps one alone."""
    rate = case.options.rate
    outcome = run_team(case.seed, case.folder / "team", rate, kill=case.options.kill)
    if case.options.alone:
        compare(outcome, run_team(case.seed, case.folder / "alone", rate, is_alone=True))
    return outcome


def summary(outcomes: list[TeamOutcome]) -> dict[str, Any]:
    """Return the figures of all arenas together."""
    sums = totals(outcomes, "victims", "found", "collisions")
    return {"arenas": len(outcomes), "simulated_s_mean": mean(outcomes, "simulated_s"), **sums}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of teams."""
    parser.add_argument("--rate", type=float, help="simulated time, at most this much faster than real time")
    parser.add_argument("--alone", action="store_true", help="also run one robot alone, and compare")
    parser.add_argument("--kill", action="store_true", help="kill every module of both robots once")


SUBJECT = TrialSubject(
    play=play,
    options=options,
    summary=summary,
    is_good=all_in_order,
    results="arenas",
    seeds=1,
    seed_makes="an arena",
)
