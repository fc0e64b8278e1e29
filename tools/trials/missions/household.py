"""Orders to the household robot in its apartment, judged by the ground truth.

    python -m tools.trials household --seeds 20 [--tasks bring,put,learn,several,door] [--kill]

Each seed puts the three objects on random tables of `apartment.yaml`, and makes other noise. Anna stands
where she gives the order, and David walks through the rooms. For each seed the robot starts again for each
task:

- bring: "bring me the …". It is right if Anna then has the object.
- put: "put the … on the …", another table. It is right if the object stands there upright.
- learn: the robot goes to the kitchen, learns it under another name, goes to the study, and comes back to
  that name. It is right if it truly stands there, and the map has the name.
- several: "go to the kitchen and bring me the … and put the … on the …".
- door: "go to the bedroom", whose doors are closed, while David, who would open one, stays in the study. It
  is right if the robot truly stands in the bedroom; it has to ask somebody to open a door.

Besides, nothing else may have fallen, and neither base nor arm may have touched anything. With `--kill`, the
tool kills every module once, at a random moment; in lockstep, as in the profile `household-fast`, the robot
waits for a restarting module.
"""

import argparse
import json
import math
import random
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from robbie_robots.workers.maps.map_annotations import read_annotations
from tools.robot import REPOSITORY
from tools.trials.harness import Case, names_of
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, mean, totals

APARTMENT = REPOSITORY / "hw" / "simulation" / "arenas" / "apartment.yaml"
NOISY = ("base", "laser", "rear_laser", "depth_camera", "manipulation")
KINDS = {"soup": "can: [0.066, 0.10]", "tea": "box: [0.06, 0.04, 0.12]", "cola": "can: [0.052, 0.14]"}
TABLES = {
    "sideboard": (2.6, 3.15, 0.0, 1.0),
    "counter": (9.15, 1.8, 1.0, 0.0),
    "drawers": (3.75, 7.15, 0.0, 1.0),
    "desk": (6.85, 7.1, 0.0, 1.0),
}
"""For each table the middle of the edge where the robot stands (m), and the direction from there inwards."""
DEEP_M, BESIDE_M, APART_M = (0.06, 0.16), 0.18, 0.13
TASKS = ("bring", "put", "learn", "several", "door")
LEARNT, PLACE_M = "sofa", 0.8
PEOPLE = """\
people:
  - {name: Anna, way: [[3.4, 4.5, 0], [3.5, 4.5, 0]], from_s: 100000}
  - {name: David, way: [[2.5, 5.4, 4], [2.5, 6.2, 0], [5.0, 6.3, 3], [5.0, 2.4, 5]], speed_m_per_s: %.2f}
"""


CROSSES, STAYS = re.compile(r"\[\[2\.5, 5\.4, 4\].*\]\]"), "[[6.0, 6.2, 4], [7.0, 6.2, 4]]"
"""David's way through the bedroom's door, and one without doors."""


@dataclass
class OrderResult(MissionTrial):
    """The result of one order, by the ground truth.

    Attributes:
        task: which of `TASKS`.
        order: the robot's order in words.
        is_right: see above.
        is_done: whether the robot says that it has done everything.
        places: for each object on what it is: a table, `person`, `hand` or `floor`.
        fallen: objects that lie.
        contacts: how often the arm, or what it held, touched a table or the floor.
        collisions: contacts of the base.
        reasons: why tasks failed, as the robot sees it.
        simulated_s: duration of the order in simulated time.
    """

    task: str = ""
    order: str = ""
    is_right: bool = False
    is_done: bool = False
    places: dict[str, str] = field(default_factory=dict)
    fallen: list[str] = field(default_factory=list)
    contacts: int = 0
    collisions: int = 0
    reasons: list[str] = field(default_factory=list)
    simulated_s: float = 0.0


@dataclass(frozen=True)
class OrderPlan:
    """One order, and what must be true in the end: for objects where they are, by name."""

    order: str
    wanted: dict[str, str]
    learns: bool = False
    closes_doors: bool = False


def apartment(seed: int) -> tuple[str, dict[str, str]]:
    """Return the apartment as the text of an arena file, and on which table each object stands."""
    chance = random.Random(seed)
    on: dict[str, str] = {}
    placed: list[tuple[float, float]] = []
    lines = []
    for name, kind in KINDS.items():
        on[name] = chance.choice(list(TABLES))
        x_m, y_m, ahead, up = TABLES[on[name]]
        while True:
            deep_m, beside_m = chance.uniform(*DEEP_M), chance.uniform(-BESIDE_M, BESIDE_M)
            at = x_m + deep_m * ahead - beside_m * up, y_m + deep_m * up + beside_m * ahead
            if all(math.dist(at, other) >= APART_M for other in placed):
                break
        placed.append(at)
        yaw_rad = chance.uniform(-math.pi, math.pi)
        lines.append(
            f"  - {{name: {name}, {kind}, x_m: {at[0]:.3f}, y_m: {at[1]:.3f}, yaw_rad: {yaw_rad:.3f}}}"
        )
    rooms, _, _ = APARTMENT.read_text().partition("objects:\n")
    people = PEOPLE % chance.uniform(0.45, 0.65)
    return rooms + "objects:\n" + "\n".join(lines) + "\n" + people, on


def plan_of(task: str, seed: int, on: dict[str, str]) -> OrderPlan:
    """Return the order of a task in a seed's apartment."""
    chance = random.Random(f"{task} {seed}")
    first, second = chance.sample(list(KINDS), 2)
    target = chance.choice([table for table in TABLES if table != on[second]])
    match task:
        case "bring":
            return OrderPlan(f"bring me the {first}", {first: "person"})
        case "put":
            return OrderPlan(f"put the {second} on the {target}", {second: target})
        case "several":
            order = f"go to the kitchen and bring me the {first} and put the {second} on the {target}"
            return OrderPlan(order, {first: "person", second: target})
        case "door":
            return OrderPlan("go to the bedroom", {}, closes_doors=True)
    order = f"go to the kitchen and this is the {LEARNT} and go to the study and go to the {LEARNT}"
    return OrderPlan(order, {}, learns=True)


def set_up(outcome: OrderResult, case: Case) -> Setup:
    """Write the apartment of a seed, and give the order of the case's task."""
    text, on = apartment(case.seed)
    file, plan = case.folder / "apartment.yaml", plan_of(case.kind, case.seed, on)
    if plan.closes_doors:
        text = CROSSES.sub(STAYS, text.replace("open: true", "open: false"))
    file.write_text(text)
    outcome.task, outcome.order = case.kind, plan.order
    settings = [f"household.start_orders={json.dumps([plan.order])}", "base.true_path=true"]
    return Setup(file, partial(judge, outcome, plan), settings)


def judge(outcome: OrderResult, plan: OrderPlan, output: Path) -> None:
    """Take the truth about objects and robot, and what the robot says."""
    arm, base, ends = (
        json.loads((output / f"{name}.json").read_text()) for name in ("arm", "base", "household")
    )
    outcome.places = {name: one["on"] for name, one in arm["objects"].items()}
    outcome.fallen = [name for name, one in arm["objects"].items() if one["lies"]]
    outcome.contacts, outcome.collisions = arm["contacts"], base["collisions"]
    outcome.reasons = [end["reason"] for end in ends if not end["is_done"]]
    outcome.is_done = bool(ends) and not outcome.reasons
    outcome.simulated_s = round(sum(end["duration_s"] for end in ends), 1)
    is_there = all(outcome.places[name] == place for name, place in plan.wanted.items())
    if plan.learns:
        is_there = has_learnt(output)
    elif plan.closes_doors:
        is_there = stands_at(output, "bedroom")
    touched = outcome.fallen or outcome.contacts or outcome.collisions
    outcome.is_right = outcome.is_done and is_there and not touched


def has_learnt(output: Path) -> bool:
    """Return whether the map has the new name, and the robot truly stands there in the end."""
    places = read_annotations(output / "map.annotations.yaml").now.places
    if LEARNT not in places:
        return False
    learnt, kitchen = places[LEARNT][:2], places["kitchen"][:2]
    return stands_at(output, LEARNT) and math.dist(learnt, kitchen) <= PLACE_M


def stands_at(output: Path, place: str) -> bool:
    """Return whether the robot truly stands at a place of its map in the end."""
    places = read_annotations(output / "map.annotations.yaml").now.places
    last = np.loadtxt(output / "truth.txt", ndmin=2)[-1, 1:3]
    return place in places and math.dist(places[place][:2], last) <= PLACE_M


def summary(outcomes: list[OrderResult]) -> dict[str, Any]:
    """Return the figures of all orders together, and of each task."""
    return {
        "orders": len(outcomes),
        "right": sum(one.is_right for one in outcomes),
        "tasks": {
            task: {
                "orders": len(those),
                "right": sum(one.is_right for one in those),
                "simulated_s_mean": mean(those, "simulated_s"),
            }
            for task in TASKS
            if (those := [one for one in outcomes if one.task == task])
        },
        "said_done_but_wrong": sum(one.is_done and not one.is_right for one in outcomes),
        **totals(outcomes, "fallen", "contacts", "collisions"),
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of orders."""
    parser.add_argument("--tasks", default=",".join(TASKS), help="the tasks, joined by commas")


SUBJECT = SeededMission(
    outcome=OrderResult,
    set_up=set_up,
    profile="household-fast",
    noisy=NOISY,
    limit_s=3000.0,
    kills_s=(2.0, 45.0),
    more_options=options,
    kinds=lambda chosen: names_of(chosen.tasks.split(","), TASKS),
    summary=summary,
    results="orders",
    seed_makes="an apartment, with an order of each task",
).subject
