"""The demo with simulated devices and with emulated ones on serial lines, in turn: are the maps alike?

    python -m tools.emulation_trial [--rounds 3] [--json FILE]

Both profiles explore the same arena. The tool compares each map with the arena: how much of the reachable
area it knows, and how far its occupied cells are from the true walls. For rescue missions, use
`python -m tools.rescue_trials --profile rescue-emulated`.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.simulation.arena import Arena
from hw.simulation.arena_file import read_arena
from tools.kill_campaign.robot import REPOSITORY, Robot, RobotTrouble
from tools.rescue_trials import mapped_share
from workers.maps.map_file import read_map
from workers.planar_pose import transform_points

ARENA = REPOSITORY / "hw" / "simulation" / "arenas" / "demo.yaml"
PROFILES = {"simulated": "demo", "emulated": "demo-emulated"}
SEEDED = {"simulated": ("base", "laser"), "emulated": ("base_emulator", "laser_emulator")}
RUN_LIMIT_S = 150.0


@dataclass(frozen=True)
class Outcome:
    """The result of one run, by the ground truth.

    Attributes:
        devices: "simulated" or "emulated".
        seed: of the devices' noise.
        mapped: share of the reachable area that is on the map.
        wall_mean_m: mean distance of the map's occupied cells from the nearest true wall.
        wall_worst_m: 95th percentile of that distance.
        from_start_m: the robot's distance from the start at the end.
        collisions: how often it touched something.
        duration_s: time from start to end.
    """

    devices: str
    seed: int
    mapped: float
    wall_mean_m: float
    wall_worst_m: float
    from_start_m: float
    collisions: int
    duration_s: float


def away_from_walls_m(arena: Arena, map_file: Path) -> NDArray[np.float64]:
    """Return the distance of each occupied cell of a map from the nearest true wall: (N,).

    The map's origin is the robot's start.
    """
    made = read_map(map_file)
    rows, columns = np.nonzero(made.cells == 100)
    places = made.corner_xy_m + (np.stack([columns, rows], axis=1) + 0.5) * made.resolution_m
    away_m: NDArray[np.float64] = arena.clearance_m(transform_points(np.array(arena.start), places))
    return np.abs(away_m)


def run(devices: str, seed: int, folder: Path) -> Outcome:
    """Run the demo once and judge it.

    Raises:
        RobotTrouble: the run did not end in order.
    """
    words = [word for name in SEEDED[devices] for word in ("--set", f"{name}.seed={seed}")]
    began_s = time.monotonic()
    robot = Robot(folder, REPOSITORY, PROFILES[devices], *words)
    try:
        robot.wait_until_running()
        while robot.is_up:
            if time.monotonic() > began_s + RUN_LIMIT_S:
                raise RobotTrouble(f"the demo did not end in {RUN_LIMIT_S} s")
            time.sleep(0.1)
        robot.wait_for_end()
        base = json.loads((robot.output / "base.json").read_text())
        arena = read_arena(ARENA)
        away_m = away_from_walls_m(arena, robot.output / "map.yaml")
        return Outcome(
            devices,
            seed,
            round(mapped_share(arena, robot.output / "map.yaml"), 4),
            round(float(away_m.mean()), 4),
            round(float(np.percentile(away_m, 95)), 4),
            round(base["from_start_m"], 3),
            base["collisions"],
            round(time.monotonic() - began_s, 1),
        )
    finally:
        robot.close()


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.emulation_trial", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="runs with each kind of devices")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(arguments)
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="robbie-emulation-") as folder:
        for seed in range(options.first, options.first + options.rounds):
            for devices in PROFILES:
                outcomes.append(run(devices, seed, Path(folder) / f"{devices}-{seed}"))
                print(json.dumps(asdict(outcomes[-1])), flush=True)
                if options.json:
                    options.json.write_text(json.dumps([asdict(each) for each in outcomes], indent=2) + "\n")
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
