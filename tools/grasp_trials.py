"""Orders to the robot with the arm in random rooms, judged by the ground truth.

    python -m tools.grasp_trials --seeds 20 [--first 0] [--kill] [--twins] [--profile NAME] [--json FILE]

Each seed makes a room with three objects on a table (`hw.simulation.table_room`), and the robot brings all
of them to another table. An order is right if the object then stands there upright. A seed is right if all
orders are, nothing fell over, and neither base, arm nor what it held touched anything else. With `--kill`,
the tool kills every module once, at a random moment; in lockstep, as in the profile `arm-fast`, the robot
waits for a restarting module.

With `--twins`, two of the objects differ only by what is printed on them. Both were taught from four pictures
each, as in `tools.print_trials`, and the robot brings one of them.
"""

import json
import signal
import sys
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hw.simulation.arena_file import read_arena
from hw.simulation.table_room import TWINS, generate_room
from tools.mission_trials import Trial, command_line, play, play_all, settings_for
from tools.print_trials import PICTURE_WIDTH, Camera, teach
from workers.objects.object_recognition import ObjectRecognizer
from workers.taught import as_json

NOISY = ("base", "laser", "depth_camera", "manipulation")
RUN_LIMIT_S = 1500.0
TAUGHT_PICTURES = 4
BEGIN_S = 2.0
"""The tool kills no module before this time of the run."""


@dataclass
class Outcome(Trial):
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
    """

    right: int = 0
    orders: int = 0
    is_right: bool = False
    fallen: list[str] = field(default_factory=list)
    slips: int = 0
    contacts: int = 0
    touches: int = 0
    reasons: list[str] = field(default_factory=list)
    simulated_s: float = 0.0


def run_room(
    outcome: Outcome, folder: Path, profile: str, kill_until_s: float, has_twins: bool = False
) -> None:
    """Run the orders in one room and judge them.

    Args:
        outcome: seed of the room, the noise and the kills; takes the results.
        folder: new folder for the run.
        profile: the profile to run.
        kill_until_s: every module is killed once until this time of the run; 0: none is killed.
        has_twins: two objects differ only by their print; the robot brings one of them.
    """
    file = folder / "room.yaml"
    file.write_text(generate_room(outcome.seed, has_twins))
    settings = settings_for(profile, file, outcome.seed, NOISY)
    if has_twins:
        settings += twins_settings(outcome.seed, file, folder)
    kills_s = (BEGIN_S, kill_until_s) if kill_until_s else None
    play(outcome, folder, profile, settings, partial(judge, outcome), limit_s=RUN_LIMIT_S, kills_s=kills_s)


def twins_settings(seed: int, room: Path, folder: Path) -> list[str]:
    """Teach the objects that differ only by their print; return the settings of the robot that knows them.

    Args:
        seed: of the room.
        room: its file.
        folder: folder for what was taught.
    """
    random = np.random.default_rng(seed)
    arena = read_arena(room)
    twins = TWINS[seed % 2][:2]
    camera, recognizer = Camera(arena, PICTURE_WIDTH, seed, 1.0), ObjectRecognizer()
    for one in arena.objects:
        if one.name in twins:
            teach(recognizer, camera, one, TAUGHT_PICTURES, random)
    file = folder / "objects.json"
    file.write_bytes(as_json("objects", recognizer.plain()))
    words = {"object": [one.name for one in arena.objects], "place": ["table", "counter"]}
    return [
        f"objects.taught_file={file}",
        f"household.words={json.dumps(words)}",
        f'household.start_orders=["put the {random.choice(twins)} on the counter"]',
    ]


def judge(outcome: Outcome, output: Path) -> None:
    """Take the truth about the objects, and the base's collisions."""
    arm = json.loads((output / "arm.json").read_text())
    ends = json.loads((output / "household.json").read_text())
    places = {name: one["on"] for name, one in arm["objects"].items()}
    outcome.fallen = [name for name, one in arm["objects"].items() if one["lies"]]
    outcome.orders = len(ends)
    outcome.right = sum(
        places.get(end["object"]) == end["place"] and end["object"] not in outcome.fallen for end in ends
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
    parser = command_line("python -m tools.grasp_trials", __doc__, "arm-fast", "number of rooms")
    parser.add_argument(
        "--kill-until",
        type=float,
        default=110.0,
        metavar="S",
        help="time of the run by which all were killed",
    )
    parser.add_argument(
        "--twins", action="store_true", help="two objects differ only by their print; bring one"
    )
    options = parser.parse_args(words)

    def play_one(seed: int, folder: Path) -> Outcome:
        outcome = Outcome(seed)
        kill_until_s = options.kill_until if options.kill else 0.0
        run_room(outcome, folder, options.profile, kill_until_s, options.twins)
        return outcome

    outcomes = play_all(options, play_one, summary, "rooms")
    return int(not all(outcome.is_right for outcome in outcomes))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
