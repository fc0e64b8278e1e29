"""Plays the Intel log in lockstep several times and checks that the trajectories are equal, bit for bit.

    python -m tools.trials intel_lockstep [--messages N] [--data DIR]

There are six runs. Three are undisturbed. In the fourth, every processor is busy. These four must give the
same trajectory.txt. In the fifth, the tool kills mapping half way, and mapping continues from its checkpoint.
The sixth plays the log without the messages that the kill lost: those handled since the last checkpoint and
the one being handled. The fifth and the sixth must give the same trajectory.txt.
"""

import argparse
import json
import os
import re
import signal
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from robbie_mp.logs.recording.carmen_import import import_carmen
from robbie_mp.logs.recording.conversion import NewChannel, converted_log
from robbie_mp.logs.recording.format import ChannelKey, TopicNames
from robbie_mp.logs.recording.reader import LoggedMessage, open_log
from robbie_mp.messages import LaserScan, Odometry
from tools.busy import busy
from tools.robot import REPOSITORY, Robot
from tools.trials.harness import Case, TrialSubject
from tools.trials.recordings import intel

CONTINUES = re.compile(r"continuing after (\d+) odometry messages and (\d+) scans")


@dataclass(frozen=True)
class Outcome:
    """The map and poses that mapping computed from a log."""

    duration_s: float
    trajectory: bytes
    odometry: int
    scans: int
    dropped: int
    restarts: int
    restored: tuple[int, int] | None
    """Odometry messages and scans contained in the checkpoint from which mapping restarted."""


def play(folder: Path, log: Path, kill_at: int = 0) -> Outcome:
    """Play a log in lockstep, as fast as possible.

    Args:
        folder: a new folder for everything the run writes.
        log: the log to play.
        kill_at: number of messages after which mapping is killed. 0: never.

    Raises:
        RobotTrouble: the run does not end, or fails.
    """
    options = ("--rate", "max", "--lockstep", "--set", "mapping.checkpoint_share=1.0")
    began_s = time.monotonic()
    robot = Robot(folder, REPOSITORY, "mapping-playback", *options, command=("play", str(log)))
    try:
        if kill_at:
            robot.wait_until_running()
            robot.wait_for(
                lambda: robot.figures()["mapping"].total("delivered") >= kill_at,
                f"mapping has not handled {kill_at} messages",
                intel.RUN_LIMIT_S,
            )
            robot.send(robot.figures()["mapping"].pid, signal.SIGKILL)
        summary = intel.ended(robot)
    finally:
        robot.close()
    mapping = next(module for module in summary["modules"] if module["name"] == "mapping")
    counted = json.loads((robot.output / "mapping.json").read_text())
    told = CONTINUES.search((robot.output / "log" / "mapping.jsonl").read_text())
    return Outcome(
        duration_s=round(time.monotonic() - began_s, 1),
        trajectory=(robot.output / "trajectory.txt").read_bytes(),
        odometry=counted["odometry_messages"],
        scans=counted["scans"],
        dropped=mapping["dropped"],
        restarts=mapping["restarts"],
        restored=(int(told[1]), int(told[2])) if told else None,
    )


def without_lost(messages: Iterable[LoggedMessage], killed: Outcome, calm: Outcome) -> list[LoggedMessage]:
    """Remove from a log the messages that a killed mapping lost.

    In lockstep these messages are consecutive. They begin after the last checkpoint; the number of each kind
    is the number missing from mapping's counts.
    """
    restored = killed.restored or (0, 0)
    left = {Odometry.type_name: restored[0], LaserScan.type_name: restored[1]}
    lost = {
        Odometry.type_name: calm.odometry - killed.odometry,
        LaserScan.type_name: calm.scans - killed.scans,
    }
    kept = []
    for message in messages:
        kind = message.channel.type_name
        if kind in left and left[kind] > 0:
            left[kind] -= 1
        elif kind in lost and lost[kind] > 0:
            lost[kind] -= 1
            continue
        kept.append(message)
    return kept


def write_log(path: Path, source: Path, messages: Iterable[LoggedMessage]) -> Path:
    """Write messages of a log into a new one."""
    topics = TopicNames()
    with converted_log(path, source) as log:
        for message in messages:
            channel = message.channel
            key = ChannelKey(channel.type_name, channel.version, channel.topic, channel.sender)
            new = NewChannel(topics.of(key), channel.type_name, channel.schema)
            log.add(new, key.metadata(), message.time_ns, message.data)
    return path


def violations(same: Sequence[Outcome], killed: Outcome, less: Outcome) -> list[str]:
    """Return the violations.

    Args:
        same: the runs that must be equal.
        killed: the run in which mapping was killed.
        less: the run of the log without the lost messages.
    """
    found = [
        f"run {number} differs" for number, run in enumerate(same) if run.trajectory != same[0].trajectory
    ]
    found += [f"{run.dropped} messages dropped" for run in (*same, killed, less) if run.dropped]
    if killed.restarts != 1 or killed.restored is None:
        found.append(f"mapping was restarted {killed.restarts} times, and restored {killed.restored}")
    if killed.trajectory != less.trajectory:
        found.append("the run with a kill is not that of the log without the lost messages")
    return found


def campaign(folder: Path, log: Path) -> intel.Report:
    """Make all runs and compare them."""
    calm = [play(folder / f"calm{number}", log) for number in range(3)]
    with busy(2 * (os.cpu_count() or 1)):
        loaded = play(folder / "loaded", log)
    killed = play(folder / "killed", log, kill_at=(calm[0].odometry + calm[0].scans) // 2)
    with open_log(log) as opened:
        shorter = write_log(folder / "less.mcap", log, without_lost(opened.messages(), killed, calm[0]))
    less = play(folder / "less", shorter)
    runs = {
        "undisturbed": calm,
        "busy processors": [loaded],
        "mapping killed": [killed],
        "log with less": [less],
    }
    return {
        "runs": {name: [_described(run) for run in outcomes] for name, outcomes in runs.items()},
        "lost in the run with a kill": calm[0].odometry + calm[0].scans - killed.odometry - killed.scans,
        "violations": violations([*calm, loaded], killed, less),
    }


def _described(run: Outcome) -> dict[str, object]:
    return asdict(run) | {"trajectory": f"{len(run.trajectory.splitlines())} lines"}


def compare(case: Case) -> intel.Report:
    """Import the log, or its beginning, and make all runs."""
    whole = case.folder / "intel.mcap"
    source = case.prepared / "intel.clf"
    import_carmen(source, whole, skip_broken=False, progress=lambda _done, _all: None)
    with open_log(whole) as opened:
        messages = list(opened.messages())[: case.options.messages]
        part = write_log(case.folder / "part.mcap", whole, messages)
    return campaign(case.folder, part)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the log."""
    parser.add_argument("--messages", type=int, metavar="N", help="play only the first N messages of the log")
    intel.options(parser)


SUBJECT = TrialSubject(
    play=lambda case: intel.report_of(partial(compare, case)),
    options=options,
    prepare=intel.data_of,
    is_good=intel.is_clean,
    seeds=1,
    seed_makes="nothing: all runs are to be equal",
)
