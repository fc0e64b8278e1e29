"""Has the household robot follow a person through the apartment, judged by the ground truth.

    python -m tools.trials follow --seeds 20 [--minutes 2] [--kill] [--hurries] [--profile NAME]

Each seed dresses the four people of `apartment.yaml` again, lets the first one walk through the lower rooms
(even seeds) or the upper ones (odd seeds) at another speed, and makes other noise. Two people cross her way
close behind her. A seed is right if the robot never went after another person, touched nobody, and follows
at the end. With `--kill`, the tool kills every module once, at a random moment; in lockstep,
as in the profile `home-fast`, the robot waits for a restarting module.

With `--hurries`, the person is faster than the robot may drive, walks out of its sight through two rooms, and
waits there: so the robot loses the person, and has to search.
"""

import argparse
import json
import random
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tools.robot import REPOSITORY
from tools.trials.harness import Case
from tools.trials.missions.mission import MissionTrial, SeededMission, Setup, mean, totals

APARTMENT = REPOSITORY / "hw" / "simulation" / "arenas" / "apartment.yaml"
NOISY = ("base", "laser", "rear_laser", "camera")
BEGIN_S, KILL_SHARE = 12.0, 0.8
"""Modules are killed between this time of the run and this share of it."""
SHIRTS = ((190, 40, 40), (40, 120, 60), (230, 200, 60), (60, 90, 190), (240, 240, 240), (120, 50, 130))
TROUSERS = ((50, 60, 110), (30, 30, 32), (120, 110, 100), (90, 80, 60))
LOWER = "[[2.3, 4.1, 0], [8.0, 4.1, 0], [8.0, 1.8, 2], [4.9, 1.8, 0], [1.7, 1.8, 3], [1.7, 4.1, 0]]"
UPPER = "[[2.3, 4.1, 0], [8.9, 4.1, 0], [8.9, 6.2, 2], [5.0, 6.2, 0], [2.5, 6.2, 3], [2.5, 4.1, 0]]"
LOWER_HURRY = (
    "[[2.3, 4.1, 0], [8.0, 4.1, 0], [8.0, 2.0, 0], [4.9, 1.8, 0], "
    "[2.6, 1.6, 40], [1.7, 1.8, 0], [1.7, 4.1, 20]]"
)
UPPER_HURRY = "[[2.3, 4.1, 0], [8.9, 4.1, 0], [8.9, 6.2, 0], [5.0, 6.3, 0], [2.4, 5.6, 40], [2.5, 4.1, 20]]"
CROSSING = "[[5.0, 2.6, 0], [5.0, 5.4, 0]]"
LOWER_CROSSING, UPPER_CROSSING = "[[3.3, 0.65, 0], [3.3, 2.9, 0]]", "[[6.0, 5.2, 0], [6.0, 7.3, 0]]"
LOWER_ROOM, UPPER_ROOM = (
    "[[1.7, 1.6, 4], [4.6, 2.2, 3]]",
    "[[2.5, 5.4, 4], [2.5, 6.4, 0], [6.0, 6.2, 3], [8.8, 6.2, 5]]",
)


@dataclass
class FollowResult(MissionTrial):
    """The result of one run, by the ground truth.

    Attributes:
        is_right: see above.
        near_share: share of the time in which the person was within 3 m.
        wrong_s: time in which the robot was after another person.
        wrong_times: how often that began.
        touches: contacts of the robot with people.
        collisions: all contacts.
        crossings: how often somebody walked between the robot and its person.
        losses: how often the robot lost the person.
        questions: how often it asked.
        farthest_m: the largest distance from the person.
        state: what the robot did at the end.
        task_s: simulated time that counts.
    """

    is_right: bool = False
    near_share: float = 0.0
    wrong_s: float = 0.0
    wrong_times: int = 0
    touches: int = 0
    collisions: int = 0
    crossings: int = 0
    losses: int = 0
    questions: int = 0
    farthest_m: float = 0.0
    state: str = ""
    task_s: float = 0.0


def apartment(seed: int, hurries: bool = False) -> str:
    """Return the apartment with other people, as the text of an arena file.

    Args:
        seed: of clothes, speeds and rooms.
        hurries: whether the first person walks faster than the robot, and waits out of its sight.
    """
    chance = random.Random(seed)
    shirts = chance.sample(SHIRTS, 4)
    is_upper = bool(seed % 2)
    slow, fast = (UPPER, UPPER_HURRY) if is_upper else (LOWER, LOWER_HURRY)
    way, speeds = (fast, (1.3, 1.6)) if hurries else (slow, (0.45, 0.6))
    walks = [
        ("Anna", way, chance.uniform(*speeds), chance.uniform(12, 16), "in_a_loop"),
        ("Ben", CROSSING, chance.uniform(0.6, 0.8), 0.0, "across"),
        ("Clara", UPPER_CROSSING if is_upper else LOWER_CROSSING, chance.uniform(0.6, 0.8), 0.0, "across"),
        ("David", LOWER_ROOM if is_upper else UPPER_ROOM, chance.uniform(0.5, 0.7), 5.0, "to_and_fro"),
    ]
    people = [
        f"  - {{name: {name}, way: {way}, speed_m_per_s: {speed:.3f}, from_s: {from_s:.2f}, walks: {how}, "
        f"shirt: {list(shirt)}, trousers: {list(chance.choice(TROUSERS))}}}"
        for (name, way, speed, from_s, how), shirt in zip(walks, shirts, strict=True)
    ]
    rooms, _, _ = APARTMENT.read_text().partition("people:\n")
    return rooms + "people:\n" + "\n".join(people) + "\n"


def set_up(outcome: FollowResult, case: Case) -> Setup:
    """Write the apartment of a seed."""
    file, duration_s = case.folder / "apartment.yaml", 60 * case.options.minutes
    file.write_text(apartment(case.seed, case.options.hurries))
    settings = [f"referee.ends_after_s={duration_s}"]
    return Setup(file, partial(judge, outcome), settings, KILL_SHARE * duration_s)


def judge(outcome: FollowResult, output: Path) -> None:
    """Take the referee's judgement, the base's contacts, and what the task has counted."""
    referee, base, task = (
        json.loads((output / f"{name}.json").read_text()) for name in ("referee", "base", "follow")
    )
    outcome.near_share, outcome.task_s = round(referee["near_share"], 3), round(referee["task_s"], 1)
    outcome.wrong_s, outcome.wrong_times = round(referee["wrong_s"], 1), referee["wrong_times"]
    outcome.crossings, outcome.farthest_m = referee["crossings"], round(referee["farthest_m"], 2)
    outcome.touches, outcome.collisions = base["touches"], base["collisions"]
    outcome.losses, outcome.questions, outcome.state = task["losses"], task["questions"], task["state"]
    follows = outcome.state in ("FOLLOW", "STAND", "LOST") and outcome.task_s > 0
    outcome.is_right = follows and not outcome.wrong_times and not outcome.touches


def summary(outcomes: list[FollowResult]) -> dict[str, Any]:
    """Return the figures of all runs together."""
    minutes = sum(one.task_s for one in outcomes) / 60
    sums = totals(
        outcomes,
        "is_right",
        "crossings",
        "wrong_times",
        "wrong_s",
        "touches",
        "collisions",
        "losses",
        "questions",
    )
    return {
        "runs": len(outcomes),
        "near_share_mean": mean(outcomes, "near_share", 3),
        "near_share_least": min(one.near_share for one in outcomes),
        "minutes": round(minutes, 1),
        "crossings_per_minute": round(sums["crossings"] / minutes, 2) if minutes else 0.0,
        "ended_alone": sum(one.state in ("IDLE", "ASK", "LOOK", "HALT") for one in outcomes),
        **sums,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of runs."""
    parser.add_argument("--minutes", type=float, default=2.0, help="duration of a run in the robot's time")
    parser.add_argument("--hurries", action="store_true", help="the person is faster than the robot")


SUBJECT = SeededMission(
    outcome=FollowResult,
    set_up=set_up,
    profile="home-fast",
    noisy=NOISY,
    limit_s=3600.0,
    kills_s=(BEGIN_S, 120.0 * KILL_SHARE),
    more_options=options,
    summary=summary,
    results="runs",
    seed_makes="clothes, ways, speeds and noise",
).subject
