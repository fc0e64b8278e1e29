"""Has the household robot learn the faces of guests, and say who is where, judged by the ground truth.

    python -m tools.trials who_is_who --faces FOLDER --seeds 20 [--kill] [--profile NAME]

The folder has pictures PERSON_NUMBER.jpg of at least three persons; the tool cuts out the heads. In each
seed, two guests tell the robot their names, one after the other, and walk to a place of their own in the
apartment of `apartment.yaml`. A third one, whom the robot does not know, stands somewhere else. Then
somebody asks who is who. While a guest is looked at, the pictures of the person change: all that the folder
has, and each of them smaller, darker, lighter, noisier, turned or mirrored, so that the robot seldom sees
the picture by which it has learnt the person. A seed is right if the robot has found each guest, within 1 m,
under the right name or as unknown, and nobody else, and has touched nobody. With `--kill`, the tool kills
every module once; in lockstep, the robot waits for a restarting module.
"""

import argparse
import json
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from robbie_robots.workers.faces.face_recognition import FaceRecognizer
from robbie_robots.workers.taught import Pixels
from tools.trials.harness import CannotTry, Case
from tools.trials.missions.follow import APARTMENT, SHIRTS, TROUSERS
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, mean, totals

NOISY = ("base", "laser", "rear_laser", "camera")
NEAR_M = 1.0
FRONT = (2.3, 4.1)
"""Where guests tell their names."""
ROOMS = ((2.5, 6.2), (6.0, 6.2), (8.7, 6.2), (8.0, 1.8), (4.9, 1.9), (1.7, 1.8))
WAYS = {
    (2.5, 6.2): ((2.5, 4.1),),
    (6.0, 6.2): ((5.0, 4.1), (5.0, 6.0)),
    (8.7, 6.2): ((8.9, 4.1),),
    (8.0, 1.8): ((8.0, 4.1),),
    (4.9, 1.9): ((5.0, 4.1),),
    (1.7, 1.8): ((5.0, 4.1), (5.0, 2.6)),
}
"""From the corridor to each place."""
STAYS_S = 3000.0
SIDES = (0.3, 0.55, 0.3, 0.2)
"""What belongs to a head to the left, above, to the right and below a found face, in sizes of the face."""


@dataclass
class TourResult(MissionTrial):
    """The result of one run, by the ground truth.

    Attributes:
        is_right: see above.
        learnt: number of guests who were learnt, of `known`.
        known: number of guests who told their names.
        named: of these, those who were found under their names.
        false_names: persons, known or not, who were found under another one's name.
        unknown_right: strangers who were found as unknown, of `strangers`.
        strangers: number of guests who did not tell their names.
        missed: guests who were not found at all.
        ghosts: persons who were found where nobody is.
        faces: pictures of faces that were compared.
        touches: contacts of the robot with people.
        duration_s: of the round, in the robot's time.
    """

    is_right: bool = False
    learnt: int = 0
    known: int = 0
    named: int = 0
    false_names: int = 0
    unknown_right: int = 0
    strangers: int = 0
    missed: int = 0
    ghosts: int = 0
    faces: int = 0
    touches: int = 0
    duration_s: float = 0.0
    people: list[dict[str, Any]] = field(default_factory=list)


def changed(picture: Pixels, seed: int = 0) -> Iterator[tuple[str, Pixels]]:
    """Yield a picture as other cameras, places and lights would show it, each with what was changed."""
    cv2: Any = import_module("cv2")
    random = np.random.default_rng(seed)
    height, width = picture.shape[:2]
    yield "as it is", picture
    yield "two thirds as large", cv2.resize(picture, None, fx=2 / 3, fy=2 / 3, interpolation=cv2.INTER_AREA)
    yield "dark", (picture * 0.45).astype(np.uint8)
    yield "light", np.clip(picture * 1.4 + 20.0, 0, 255).astype(np.uint8)
    yield "noisy", np.clip(picture + random.normal(0.0, 15.0, picture.shape), 0, 255).astype(np.uint8)
    yield "blurred", cv2.GaussianBlur(picture, (0, 0), 2.0)
    for degrees in (-12, 12):
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
        yield f"turned by {degrees} degrees", cv2.warpAffine(picture, turn, (width, height))
    yield "mirrored", np.ascontiguousarray(picture[:, ::-1])


def heads_in(folder: Path) -> dict[str, list[Pixels]]:
    """Return the heads in a folder's pictures, by person, each also as other cameras would show it.

    Raises:
        CannotTry: there are fewer than three persons.
    """
    cv2: Any = import_module("cv2")
    recognizer = FaceRecognizer(doublings=1)
    heads: dict[str, list[Pixels]] = {}
    for file in sorted(folder.glob("*.jpg")):
        picture = cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB)
        boxes = [one.box for one in recognizer.find(picture)]
        if not boxes:
            continue
        box = max(boxes, key=lambda one: one.width * one.height)
        left, above, right, below = SIDES
        top, start = int(box.top - above * box.height), int(box.left - left * box.width)
        bottom, end = int(box.top + (1 + below) * box.height), int(box.left + (1 + right) * box.width)
        head = picture[max(0, top) : bottom, max(0, start) : end]
        name = file.stem.split("_")[0].capitalize()
        heads.setdefault(name, []).extend(np.ascontiguousarray(seen) for _, seen in changed(head))
    if len(heads) < 3:
        raise CannotTry(f"{folder}: pictures PERSON_NUMBER.jpg of at least three persons are needed")
    return heads


def party(seed: int, heads: dict[str, list[Pixels]], folder: Path) -> tuple[str, list[str]]:
    """Write the guests' pictures.

    Args:
        seed: of guests, places, clothes and pictures.
        heads: of all persons.
        folder: new folder for the pictures.

    Returns:
        The apartment with the guests, as the text of an arena file, and the names of those who tell them.
    """
    cv2: Any = import_module("cv2")
    chance = random.Random(seed)
    folder.mkdir()
    guests = chance.sample(sorted(heads), 3)
    for name in guests:
        pictures = chance.sample(heads[name], len(heads[name]))
        for number, picture in enumerate(pictures):
            cv2.imwrite(str(folder / f"{name}_{number:02}.png"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    first, second, third = chance.sample(ROOMS, 3)
    ways = [
        [(*FRONT, 0.0), *((*at, 0.0) for at in WAYS[first]), (*first, STAYS_S)],
        [
            (5.0, 2.7, 0.0),
            (5.0, 4.1, 0.0),
            (*FRONT, 14.0),
            *((*at, 0.0) for at in WAYS[second]),
            (*second, STAYS_S),
        ],
        [(*third, STAYS_S), (third[0] + 0.1, third[1], STAYS_S)],
    ]
    shirts = chance.sample(SHIRTS, 3)
    people = [
        f"  - {{name: {name}, way: {[list(point) for point in way]}, speed_m_per_s: 1.0, from_s: {from_s}, "
        f"shirt: {list(shirt)}, trousers: {list(chance.choice(TROUSERS))}}}"
        for name, way, from_s, shirt in zip(guests, ways, (12.0, 18.0, STAYS_S), shirts, strict=True)
    ]
    rooms, _, _ = APARTMENT.read_text().partition("people:\n")
    return rooms + "people:\n" + "\n".join(people) + "\n", guests[:2]


def set_up(outcome: TourResult, case: Case) -> Setup:
    """Write the guests of a seed."""
    arena, introduced = party(case.seed, case.prepared, case.folder / "faces")
    file = case.folder / "apartment.yaml"
    file.write_text(arena)
    settings = [f"camera.faces={case.folder / 'faces'}", f"guests.introduce=[{', '.join(introduced)}]"]
    return Setup(file, partial(judge, outcome, introduced), [*settings, "guests.asks_s=46"])


def judge(outcome: TourResult, introduced: list[str], output: Path) -> None:
    """Compare the robot's answer with the truth."""
    told, base = (json.loads((output / f"{name}.json").read_text()) for name in ("guests", "base"))
    found = list(told["found"])
    outcome.people = list(found)
    outcome.known, outcome.strangers = len(introduced), len(told["truth"]) - len(introduced)
    outcome.learnt = len(told["known"])
    outcome.faces = sum(one["faces"] for one in found)
    for person in told["truth"]:
        near = [one for one in found if _apart_m(one, person) <= NEAR_M]
        if not near:
            outcome.missed += 1
            continue
        one = min(near, key=partial(_apart_m, person))
        found.remove(one)
        outcome.false_names += one["name"] not in ("", person["name"])
        is_known = person["name"] in introduced
        outcome.named += is_known and one["name"] == person["name"]
        outcome.unknown_right += not is_known and not one["name"]
    outcome.ghosts = len(found)
    outcome.touches, outcome.duration_s = base["touches"], round(told["duration_s"], 1)
    is_all = outcome.named == outcome.known and outcome.unknown_right == outcome.strangers > 0
    outcome.is_right = is_all and not outcome.ghosts and not outcome.touches


def _apart_m(one: dict[str, Any], other: dict[str, Any]) -> float:
    return math.dist((one["x_m"], one["y_m"]), (other["x_m"], other["y_m"]))


def summary(outcomes: list[TourResult]) -> dict[str, Any]:
    """Return the figures of all runs together."""
    sums = totals(
        outcomes,
        "is_right",
        "learnt",
        "known",
        "named",
        "false_names",
        "unknown_right",
        "strangers",
        "missed",
        "ghosts",
        "touches",
    )
    known, persons = sums["known"], sums["known"] + sums["strangers"]
    return {
        "runs": len(outcomes),
        "false_rejects": round(1 - sums["named"] / known, 3) if known else 0.0,
        "false_accepts": round(sums["false_names"] / persons, 3) if persons else 0.0,
        "duration_s_mean": mean(outcomes, "duration_s"),
        **sums,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of runs."""
    parser.add_argument("--faces", type=Path, required=True, help="with pictures PERSON_NUMBER.jpg")


SUBJECT = SeededMission(
    outcome=TourResult,
    set_up=set_up,
    profile="home-faces",
    noisy=NOISY,
    limit_s=1200.0,
    kills_s=(6.0, 80.0),
    more_options=options,
    prepare=lambda chosen: heads_in(chosen.faces),
    summary=summary,
    results="runs",
    seed_makes="guests",
).subject
