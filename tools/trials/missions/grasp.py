"""Orders to the robot with the arm in random rooms, judged by the ground truth.

    python -m tools.trials grasp --seeds 20 [--kill] [--profile NAME]

Each seed makes a room with three objects on a table (`hw.simulation.table_room`), and the robot brings all
of them to another table. An order is right if the object then stands there upright. A seed is right if all
orders are, nothing fell over, and neither base, arm nor what it held touched anything else. With `--kill`,
the tool kills every module once, at a random moment; in lockstep, as in the profile `arm-fast`, the robot
waits for a restarting module.
"""

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from robbie_robots.hw.simulation.table_room import generate_room
from tools.trials.harness import Case
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, mean, totals

NOISY = ("base", "laser", "depth_camera", "manipulation")


@dataclass
class GraspResult(MissionTrial):
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


def set_up(outcome: GraspResult, case: Case) -> Setup:
    """Make the room of a seed."""
    file = case.folder / "room.yaml"
    file.write_text(generate_room(case.seed))
    return Setup(file, partial(judge, outcome))


def judge(outcome: GraspResult, output: Path) -> None:
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


def summary(outcomes: list[GraspResult]) -> dict[str, Any]:
    """Return the figures of all rooms together."""
    return {
        "rooms": len(outcomes),
        "simulated_s_mean": mean(outcomes, "simulated_s"),
        **totals(outcomes, "is_right", "orders", "right", "fallen", "slips", "contacts", "touches"),
    }


SUBJECT = SeededMission(
    outcome=GraspResult,
    set_up=set_up,
    profile="arm-fast",
    noisy=NOISY,
    limit_s=1500.0,
    kills_s=(2.0, 110.0),
    summary=summary,
    results="rooms",
    seed_makes="a room",
).subject
