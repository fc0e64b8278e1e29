"""Orders to the robot with the arm in random rooms, judged by the ground truth.

    python -m tools.grasp_trials --seeds 20 [--first 0] [--kill] [--profile NAME] [--json FILE]

Each seed makes a room with three objects on a table (`hw.simulation.table_room`), and the robot brings all
of them to another table. An order is right if the object then stands there upright. A seed is right if all
orders are, nothing fell over, and neither base, arm nor what it held touched anything else. With `--kill`,
the tool kills every module once, at a random moment; in lockstep, as in the profile `arm-fast`, the robot
waits for a restarting module.
"""

import argparse
import json
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hw.simulation.table_room import generate_room
from robbie_mp.profile.load import load_profile
from tools.kill_campaign.robot import REPOSITORY, Robot, RobotTrouble
from tools.mission_kills import Kills, watch

NOISY = ("base", "laser", "depth_camera", "manipulation")
RUN_LIMIT_S = 1500.0
BEGIN_S = 2.0
"""The tool kills no module before this time of the run."""


@dataclass
class Outcome:
    """The result of one room, by the ground truth.

    Attributes:
        right: orders whose object stands where it should.
        orders: number of orders.
        is_right: whether all are right, and nothing else was touched.
        slips: how often an object slipped out of the hand.
        contacts: how often the arm, or what it held, touched a table or the floor.
        touches: number of collisions of the base.
        reasons: why orders failed, as the robot sees it.
        simulated_s: duration of all orders in simulated time.
        wall_s: duration of the run in real time.
        restarts: number of restarts of killed modules.
        trouble: why the run itself failed; '' if it did not.
    """

    seed: int
    right: int = 0
    orders: int = 0
    is_right: bool = False
    fallen: list[str] = field(default_factory=list)
    slips: int = 0
    contacts: int = 0
    touches: int = 0
    reasons: list[str] = field(default_factory=list)
    simulated_s: float = 0.0
    wall_s: float = 0.0
    restarts: dict[str, int] = field(default_factory=dict)
    trouble: str = ""


def run_room(outcome: Outcome, folder: Path, profile: str, kill_until_s: float) -> None:
    """Run the orders in one room and judge them.

    Args:
        outcome: seed of the room, the noise and the kills; takes the results.
        folder: new folder for the run.
        profile: the profile to run.
        kill_until_s: every module is killed once until this time of the run; 0: none is killed.
    """
    seed, file = outcome.seed, folder / "room.yaml"
    file.write_text(generate_room(seed))
    settings = []
    for spec in load_profile(profile, REPOSITORY).modules:
        settings += [f"{spec.name}.arena={file}"] if "arena" in spec.settings else []
        settings += [f"{spec.name}.seed={seed}"] if spec.name in NOISY else []
    words = [profile, *(word for setting in settings for word in ("--set", setting))]
    began_s = time.monotonic()
    robot = Robot(folder / "run", REPOSITORY, *words)
    try:
        robot.wait_until_running(limit_s=300.0)
        watch(robot, Kills(robot, seed, BEGIN_S, kill_until_s) if kill_until_s else None, RUN_LIMIT_S)
        summary = robot.wait_for_end()
        outcome.restarts = {each["name"]: each["restarts"] for each in summary["modules"] if each["restarts"]}
        judge(outcome, robot.output)
    except (RobotTrouble, OSError) as trouble:
        outcome.trouble = str(trouble)
    finally:
        robot.close()
    outcome.wall_s = round(time.monotonic() - began_s, 1)


def judge(outcome: Outcome, output: Path) -> None:
    """Take the truth about the objects, and the base's collisions."""
    arm = json.loads((output / "arm.json").read_text())
    ends = json.loads((output / "bring.json").read_text())
    places = {name: one["on"] for name, one in arm["objects"].items()}
    outcome.fallen = [name for name, one in arm["objects"].items() if one["lies"]]
    outcome.orders = len(ends)
    outcome.right = sum(
        places.get(end["object"]) == end["target"] and end["object"] not in outcome.fallen for end in ends
    )
    outcome.slips, outcome.contacts = arm["slips"], arm["contacts"]
    outcome.touches = json.loads((output / "base.json").read_text())["collisions"]
    outcome.reasons = [end["reason"] for end in ends if not end["is_done"]]
    outcome.simulated_s = round(sum(end["duration_s"] for end in ends), 1)
    touched = outcome.fallen or outcome.contacts or outcome.touches
    outcome.is_right = bool(ends) and outcome.right == outcome.orders and not touched


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the figures of all rooms together."""
    return {
        "rooms": len(outcomes),
        "rooms_right": sum(outcome.is_right for outcome in outcomes),
        "orders": sum(outcome.orders for outcome in outcomes),
        "orders_right": sum(outcome.right for outcome in outcomes),
        "fallen": sum(len(outcome.fallen) for outcome in outcomes),
        "slips": sum(outcome.slips for outcome in outcomes),
        "contacts": sum(outcome.contacts for outcome in outcomes),
        "touches": sum(outcome.touches for outcome in outcomes),
        "simulated_s_mean": round(sum(outcome.simulated_s for outcome in outcomes) / len(outcomes), 1),
        "trouble": sum(bool(outcome.trouble) for outcome in outcomes),
    }


def main(words: list[str] | None = None) -> int:
    """Run the command line. The exit code is 0 if every room was right, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tools.grasp_trials", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="number of rooms")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--profile", default="arm-fast")
    parser.add_argument("--kill", action="store_true", help="kill every module once")
    parser.add_argument(
        "--kill-until",
        type=float,
        default=110.0,
        metavar="S",
        help="time of the run by which all were killed",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(words)
    folder = Path(tempfile.mkdtemp(prefix="robbie-grasps-"))
    outcomes: list[Outcome] = []
    try:
        for seed in range(options.first, options.first + options.seeds):
            place = folder / str(seed)
            place.mkdir()
            outcome = Outcome(seed)
            run_room(outcome, place, options.profile, options.kill_until if options.kill else 0.0)
            outcomes.append(outcome)
            print(json.dumps(asdict(outcome)), flush=True)
            report = {"summary": summary(outcomes), "rooms": [asdict(each) for each in outcomes]}
            if options.json:
                options.json.write_text(json.dumps(report, indent=2) + "\n")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(json.dumps(summary(outcomes), indent=2))
    return int(not all(outcome.is_right for outcome in outcomes))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
