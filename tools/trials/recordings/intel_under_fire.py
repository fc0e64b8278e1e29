"""Maps the Intel Research Lab while the mapping module and the core are killed again and again.

    python -m tools.trials intel_under_fire [--mapping-kills 5] [--core-kills 3] [--data DIR]

The tool maps the same log twice: undisturbed, and with kills. Mapping saves a checkpoint after every scan.
Only the message that a killed mapping was handling may be lost, and it must be counted. The map must be as
good.
"""

import argparse
import json
import random
import signal
import time
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tools.robot import REPOSITORY, Robot
from tools.slam_metric import measure, read_table
from tools.trials.harness import Case, TrialSubject
from tools.trials.recordings import intel

RUN_LIMIT_S = 600.0
SCAN = "sensor_msgs/msg/LaserScan"
ALLOWED_ERROR_RATIO = 1.1


@dataclass(frozen=True)
class Shot:
    """A planned kill, after a given number of handled messages."""

    name: str
    at_handled: int


@dataclass
class Outcome:
    """How a run ended."""

    exit_code: int
    duration_s: float
    odometry: int
    scans: int
    scans_routed: int
    scans_lost: int
    dropped: int
    lost: int
    translation_mean_m: float
    rotation_mean_deg: float
    relations_used: int
    restarts: dict[str, int] = field(default_factory=dict)
    map_bytes: int = 0


def map_intel(folder: Path, data: Path, shots: list[Shot]) -> Outcome:
    """Run the profile `intel` once, killing as planned.

    Raises:
        RobotTrouble: the run does not end.
    """
    log, share = f"playback.file={data / 'intel.clf'}", "mapping.checkpoint_share=1.0"
    robot = Robot(folder, REPOSITORY, "intel", "--fresh", "--set", log, "--set", share)
    began_s = time.monotonic()
    try:
        robot.wait_until_running()
        for shot in sorted(shots, key=lambda shot: shot.at_handled):
            _wait_until_handled(robot, shot.at_handled)
            _kill(robot, shot.name)
        summary = robot.wait_for_end(RUN_LIMIT_S)
    finally:
        robot.close()
    return _outcome(robot, summary, data, time.monotonic() - began_s)


def _wait_until_handled(robot: Robot, messages: int) -> None:
    def handled() -> bool:
        return robot.figures()["mapping"].total("delivered") >= messages

    robot.wait_for(handled, f"mapping has not handled {messages} messages", RUN_LIMIT_S)


def _kill(robot: Robot, name: str) -> None:
    """Kill a module while it is RUNNING. If it is still restarting, wait for it."""

    def killed() -> bool:
        return robot.all_running() and robot.send(robot.figures()[name].pid, signal.SIGKILL)

    robot.wait_for(killed, f"{name} is not RUNNING")


def _outcome(robot: Robot, summary: dict[str, Any], data: Path, duration_s: float) -> Outcome:
    modules = {module["name"]: module for module in summary["modules"]}
    counted = json.loads((robot.output / "mapping.json").read_text())
    trajectory = read_table(robot.output / "trajectory.txt", 4, "t x y theta")
    score = measure(trajectory, read_table(data / "intel.relations", 8, "t1 t2 dx dy dz roll pitch yaw"))
    books = modules["mapping"]["subscriptions"]
    return Outcome(
        exit_code=summary["exit_code"],
        duration_s=round(duration_s, 1),
        odometry=counted["odometry_messages"],
        scans=counted["scans"],
        scans_routed=sum(entry["routed"] for entry in books if entry["type_name"] == SCAN),
        scans_lost=sum(entry["lost"] for entry in books if entry["type_name"] == SCAN),
        dropped=sum(entry["dropped"] for entry in books),
        lost=sum(entry["lost"] for entry in books),
        translation_mean_m=round(score.translation_mean_m, 4),
        rotation_mean_deg=round(score.rotation_mean_deg, 3),
        relations_used=score.relations_used,
        restarts={name: module["restarts"] for name, module in modules.items() if module["restarts"]},
        map_bytes=(robot.output / "map.png").stat().st_size,
    )


def violations(calm: Outcome, fire: Outcome, kills: dict[str, int]) -> list[str]:
    """Compare both runs, and return the violations."""
    found = []
    if fire.exit_code:
        found.append(f"exit code {fire.exit_code}")
    if fire.restarts != kills:
        found.append(f"restarts {fire.restarts}, kills {kills}")
    if fire.dropped or fire.lost > kills.get("mapping", 0):
        found.append(f"{fire.dropped} messages dropped, {fire.lost} lost")
    if fire.scans < calm.scans - kills.get("mapping", 0):
        found.append(f"{calm.scans - fire.scans} scans are missing in the map")
    if fire.translation_mean_m > ALLOWED_ERROR_RATIO * calm.translation_mean_m:
        found.append(f"error {fire.translation_mean_m} m, undisturbed {calm.translation_mean_m} m")
    return found


def spread(kills: dict[str, int], messages: int, seed: int) -> list[Shot]:
    """Choose moments between 5 and 95 % of a run, counted in messages: one in each of several equal parts."""
    chance = random.Random(seed)
    names = [name for name, count in kills.items() for _ in range(count)]
    chance.shuffle(names)
    part = 0.9 * messages / max(1, len(names))
    return [
        Shot(name, round(0.05 * messages + part * (at + chance.uniform(0.1, 0.9))))
        for at, name in enumerate(names)
    ]


def compare(case: Case) -> intel.Report:
    """Map the log undisturbed and under fire."""
    data: Path = case.prepared
    kills = {"mapping": case.options.mapping_kills, "core": case.options.core_kills}
    calm = map_intel(case.folder / "calm", data, [])
    shots = spread(kills, calm.odometry + calm.scans, case.seed)
    fire = map_intel(case.folder / "fire", data, shots)
    found = violations(calm, fire, {name: count for name, count in kills.items() if count})
    return {"undisturbed": asdict(calm), "under_fire": asdict(fire), "violations": found}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of kills."""
    parser.add_argument("--mapping-kills", type=int, default=5)
    parser.add_argument("--core-kills", type=int, default=3)
    intel.options(parser)


SUBJECT = TrialSubject(
    play=lambda case: intel.report_of(partial(compare, case)),
    options=options,
    prepare=intel.data_of,
    is_good=intel.is_clean,
    seeds=1,
    seed_makes="the moments of the kills",
)
