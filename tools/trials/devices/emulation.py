"""The same robots with simulated devices and with emulated ones on serial lines: do they do the same?

    python -m tools.trials emulation [demo] [rescue] [--seeds 8]

For each seed both robots carry out the same mission, one after the other. They have the same body, the same
rates, and lasers with the same field of view, beams, noise and range; the seed is that of the noise and, for
rescue, of the arena. The tool compares the results with the ground truth. It tests by sign flips of the
pairs whether the emulated robot differs.
"""

import argparse
import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.run.profile.load import load_profile
from robbie_robots.hw.emulation.scip import UTM_30LX
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.arena_generator import ArenaWishes
from robbie_robots.hw.simulation.generate_arena import generate_arena
from robbie_robots.workers.maps.map_file import read_map
from robbie_robots.workers.planar_pose import transform_points, wrap_angle
from tools.robot import REPOSITORY, Robot, RobotTrouble
from tools.trials.devices.paired_test import SignFlips, TooFewPairs
from tools.trials.harness import Case, TrialSubject, names_of
from tools.trials.missions.rescue import NOISY, judge, mapped_share
from tools.trials.missions.rescue import Outcome as RescueOutcome

Array = NDArray[np.float64]

DEMO_ARENA = REPOSITORY / "hw" / "simulation" / "arenas" / "demo.yaml"
WISHES = ArenaWishes(width_m=5.0, height_m=4.0, victims=2, signs=1, obstacles=2)
RANGE_MAX_M = 10.0
MERGE = 3
LASER_TWIN: dict[str, object] = {
    "laser.angle_min_rad": float(UTM_30LX.angles_rad()[0]),
    "laser.angle_increment_rad": 2 * math.pi / UTM_30LX.steps_per_turn,
    "laser.steps": len(UTM_30LX.angles_rad()),
    "laser.merge": MERGE,
    "laser.range_max_m": RANGE_MAX_M,
    "laser.period_s": 0.1,
}
"""Settings that give a simulated laser the beams of the emulated one."""
FIGURES = {
    "mapped": "reachable area on the map",
    "wall_mean_m": "mean distance of the map's walls from the true ones, m",
    "pose_mean_m": "mean error of the position, m",
    "pose_worst_m": "largest error of the position, m",
    "heading_mean_deg": "mean error of the heading, degrees",
    "from_start_m": "distance from the start at the end, m",
    "collisions": "collisions",
    "found": "victims placed within 0.2 m",
    "duration_s": "time of the mission, s",
}


@dataclass(frozen=True)
class Mission:
    """A mission for two robots that differ in their devices.

    Attributes:
        simulated: profile of the robot with simulated devices.
        emulated: profile of the robot with emulated devices.
        twin: settings that make the simulated robot as the emulated one is.
        same: settings of both robots.
        wishes: contents of an arena for each seed; None: the profile's arena.
        limit_s: time after which a run counts as failed.
    """

    simulated: str
    emulated: str
    twin: dict[str, object]
    same: dict[str, object]
    wishes: ArenaWishes | None
    limit_s: float


MISSIONS = {
    "demo": Mission(
        "demo",
        "demo-emulated",
        {"base.body": "create", "base.period_s": 0.015} | LASER_TWIN,
        {},
        None,
        150.0,
    ),
    # A Pioneer's controller reports ten times each second; its body is the stock robot's.
    "rescue": Mission(
        "parts/simulated-rescue",
        "rescue-emulated",
        {"base.period_s": 0.1} | LASER_TWIN,
        {"mission.time_limit_s": 240.0},
        WISHES,
        360.0,
    ),
}


@dataclass(frozen=True)
class Outcome:
    """The result of one run, by the ground truth; `FIGURES` says what the figures are.

    Attributes:
        mission: "demo" or "rescue".
        devices: "simulated" or "emulated".
        seed: of noise and arena.
        load: mean number of processes that wanted to run in the last minute of the run, on the whole machine.
    """

    mission: str
    devices: str
    seed: int
    mapped: float
    wall_mean_m: float
    pose_mean_m: float
    pose_worst_m: float
    heading_mean_deg: float
    from_start_m: float
    collisions: int
    found: int
    duration_s: float
    load: float


def away_from_walls_m(arena: Arena, map_file: Path) -> Array:
    """Return the distance of each occupied cell of a map from the nearest true wall: (N,).

    The map's origin is the robot's start.
    """
    made = read_map(map_file)
    rows, columns = np.nonzero(made.cells == 100)
    places = made.corner_xy_m + (np.stack([columns, rows], axis=1) + 0.5) * made.resolution_m
    away_m: Array = arena.clearance_m(transform_points(np.array(arena.start), places))
    return np.abs(away_m)


def pose_errors(estimated: Array, truth: Array) -> tuple[Array, Array]:
    """Return the errors of a trajectory's positions, m, and headings, rad, at its stamps: (N,) each.

    Args:
        estimated: `(M, 4)`: stamp (s), x (m), y (m), heading (rad).
        truth: `(T, 4)` likewise, sorted by stamp. What lies outside its time is left out.
    """
    times = estimated[:, 0]
    inside = estimated[(times >= truth[0, 0]) & (times <= truth[-1, 0])]
    headings = np.unwrap(truth[:, 3])
    x, y, heading = (
        np.interp(inside[:, 0], truth[:, 0], column) for column in (truth[:, 1], truth[:, 2], headings)
    )
    away_m: Array = np.hypot(inside[:, 1] - x, inside[:, 2] - y)
    return away_m, np.abs(wrap_angle(inside[:, 3] - heading))


def settings_of(mission: Mission, devices: str, seed: int, arena: Path | None) -> list[str]:
    """Return the words for the command line that set up one robot."""
    profile = mission.emulated if devices == "emulated" else mission.simulated
    settings = dict(mission.same)
    for spec in load_profile(profile, REPOSITORY).modules:
        # The driver of an emulated device has no arena and no noise.
        if spec.settings.get("arena") is not None:
            settings |= {f"{spec.name}.arena": arena} if arena is not None else {}
            settings |= {f"{spec.name}.seed": seed} if spec.name in NOISY else {}
    true_base = "base_emulator" if devices == "emulated" else "base"
    settings |= {f"{true_base}.true_path": "true"}
    settings |= {"laser_emulator.range_max_m": RANGE_MAX_M} if devices == "emulated" else mission.twin
    return [profile, *(word for name, value in settings.items() for word in ("--set", f"{name}={value}"))]


def run(name: str, devices: str, seed: int, folder: Path) -> Outcome:
    """Run a mission once and judge it.

    Raises:
        RobotTrouble: the run did not end in order.
    """
    mission = MISSIONS[name]
    file = DEMO_ARENA
    if mission.wishes is not None:
        file = folder / "arena.yaml"
        file.write_text(generate_arena(seed, mission.wishes))
    words = settings_of(mission, devices, seed, None if mission.wishes is None else file)
    robot = Robot(folder / "run", REPOSITORY, *words)
    try:
        robot.wait_until_running()
        began_s = time.monotonic()
        while robot.is_up:
            if time.monotonic() > began_s + mission.limit_s:
                raise RobotTrouble(f"the mission did not end in {mission.limit_s:g} s")
            time.sleep(0.1)
        summary = robot.wait_for_end()
        if summary["exit_code"]:
            raise RobotTrouble(f"the run has failed: {summary['reason']}")
        return judged(name, devices, seed, read_arena(file), robot.output)
    finally:
        robot.close()


def judged(name: str, devices: str, seed: int, arena: Arena, output: Path) -> Outcome:
    """Compare the results of a run with the ground truth."""
    base = json.loads((output / "base.json").read_text())
    estimated = np.loadtxt(output / "trajectory.txt", ndmin=2)
    away_m, turned_rad = pose_errors(estimated, np.loadtxt(output / "truth.txt", ndmin=2))
    found = 0
    if (output / "mission.json").exists():
        rescue = RescueOutcome(seed)
        judge(rescue, arena, output)
        found = rescue.found
    return Outcome(
        name,
        devices,
        seed,
        round(mapped_share(arena, output / "map.yaml"), 4),
        round(float(away_from_walls_m(arena, output / "map.yaml").mean()), 4),
        round(float(away_m.mean()), 4),
        round(float(away_m.max()), 4),
        round(float(np.degrees(turned_rad).mean()), 3),
        round(base["from_start_m"], 3),
        base["collisions"],
        found,
        round(float(np.ptp(estimated[:, 0])), 1),
        round(os.getloadavg()[0], 1),
    )


def report(outcomes: Sequence[Outcome]) -> str:
    """Return the figures of each mission, and whether the emulated robots differ from the simulated ones."""
    lines = []
    for name in dict.fromkeys(outcome.mission for outcome in outcomes):
        pairs = paired([outcome for outcome in outcomes if outcome.mission == name])
        lines.append(f"{name}, {len(pairs)} pairs: mean simulated, emulated; difference [95 %], p")
        lines += [_compared(figure, pairs) for figure in FIGURES]
        loads = [outcome.load for pair in pairs for outcome in pair]
        lines.append(f"  load of the machine: {min(loads, default=0):g} to {max(loads, default=0):g}")
    return "\n".join(lines)


def paired(outcomes: Sequence[Outcome]) -> list[tuple[Outcome, Outcome]]:
    """Return the runs with simulated and emulated devices that have the same seed."""
    by_kind = {
        kind: {outcome.seed: outcome for outcome in outcomes if outcome.devices == kind}
        for kind in ("simulated", "emulated")
    }
    both = sorted(by_kind["simulated"].keys() & by_kind["emulated"].keys())
    return [(by_kind["simulated"][seed], by_kind["emulated"][seed]) for seed in both]


def _compared(figure: str, pairs: list[tuple[Outcome, Outcome]]) -> str:
    simulated, emulated = (np.array([float(getattr(pair[at], figure)) for pair in pairs]) for at in range(2))
    text = f"  {FIGURES[figure]}: {simulated.mean():.4g}, {emulated.mean():.4g}"
    try:
        flips = SignFlips(emulated - simulated)
        low, high = flips.confidence_interval()
    except TooFewPairs as error:
        return f"{text}; {error}"
    difference = (emulated - simulated).mean()
    return f"{text}; {difference:+.3g} [{low:+.3g}, {high:+.3g}], p = {flips.p_value():.3f}"


def play(case: Case) -> dict[str, Any]:
    """Run one robot; the result says what was wrong if the run itself failed."""
    name, devices = case.kind.split("-")
    try:
        return asdict(run(name, devices, case.seed, case.folder)) | {"trouble": ""}
    except RobotTrouble as trouble:
        return {"mission": name, "devices": devices, "seed": case.seed, "trouble": str(trouble)}


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the comparison of the runs that did not fail, and how many did."""
    good = [{name: one[name] for name in one if name != "trouble"} for one in results if not one["trouble"]]
    compared = report([Outcome(**one) for one in good]).splitlines()
    return {"compared": compared, "failed": len(results) - len(good)}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the missions."""
    missions = f"of {', '.join(MISSIONS)}; default: all"
    parser.add_argument("missions", nargs="*", metavar="MISSION", help=missions)


def kinds(chosen: argparse.Namespace) -> list[str]:
    """Return each mission with each kind of devices."""
    names = names_of(chosen.missions, MISSIONS)
    return [f"{name}-{devices}" for name in names for devices in ("simulated", "emulated")]


SUBJECT = TrialSubject(
    play=play,
    options=options,
    kinds=kinds,
    summary=summary,
    is_good=lambda results: not any(one["trouble"] for one in results),
    results="runs",
    seeds=8,
    seed_makes="noise and an arena",
)
