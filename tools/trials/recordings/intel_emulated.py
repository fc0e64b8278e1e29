"""Maps the Intel log directly and through emulated serial devices: are the trajectories equally good?

    python -m tools.trials intel_emulated [--rate 4] [--seconds N] [--data DIR]

The direct playback hands the recorded odometry and scans to mapping. In the other run an emulated Create 2
and an emulated SICK LMS2xx repeat the drive, and the drivers read their bytes. The error is that of
`tools.slam_metric`, with the same relations for both.
"""

import argparse
import json
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools.robot import REPOSITORY, Robot
from tools.slam_metric import measure, read_table
from tools.trials.harness import Case, TrialSubject
from tools.trials.recordings import intel

Array = NDArray[np.float64]

RECORDS = ("ODOM ", "FLASER ")


def play(profile: str, folder: Path, *settings: str) -> Path:
    """Run a profile to its end; return the folder of its output.

    Raises:
        RobotTrouble: the run failed.
    """
    words = [word for setting in settings for word in ("--set", setting)]
    robot = Robot(folder, REPOSITORY, profile, *words)
    try:
        intel.ended(robot)
    finally:
        robot.close()
    return robot.output


def with_stamps_of_log(trajectory: Array, played: Array) -> Array:
    """Return the poses of a played drive with the stamps of the log, a row for each odometry record: (N, 4).

    Args:
        trajectory: (M, 4) stamp (s), x, y (m), heading (rad), by the time of the run.
        played: (N, 2) when, by the time of the run, each record was played, and its own stamp, s. Those
            outside the trajectory are left out.
    """
    times_s = trajectory[:, 0]
    inside = played[(played[:, 0] >= times_s[0]) & (played[:, 0] <= times_s[-1])]
    columns = (trajectory[:, 1], trajectory[:, 2], np.unwrap(trajectory[:, 3]))
    poses = [np.interp(inside[:, 0], times_s, column) for column in columns]
    return np.column_stack([inside[:, 1], *poses])


def beginning(log: Path, target: Path, seconds: float) -> Path:
    """Write the lines of a CARMEN log up to a time after its start, which is the last column of a record."""
    lines = log.read_text().splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith(RECORDS) or float(line.split()[-1]) <= seconds]
    target.write_text("".join(kept))
    return target


def compare(folder: Path, data: Path, rate: float, seconds: float | None) -> intel.Report:
    """Make both runs, and return errors and counts."""
    log = data / "intel.clf"
    folder.mkdir(parents=True, exist_ok=True)
    if seconds is not None:
        log = beginning(log, folder / "part.clf", seconds)
    direct = play("intel", folder / "direct", f"playback.file={log}")
    emulated = play("intel-emulated", folder / "emulated", f"playback.file={log}", f"playback.rate={rate}")
    of_direct = read_table(direct / "trajectory.txt", 4, "t x y theta")
    played = read_table(emulated / "played.txt", 2, "t ipc_time")
    of_emulated = with_stamps_of_log(read_table(emulated / "trajectory.txt", 4, "t x y theta"), played)
    relations = read_table(data / "intel.relations", 8, "t1 t2 dx dy dz roll pitch yaw")
    end_s = min(of_direct[:, 0].max(), of_emulated[:, 0].max())
    relations = relations[(relations[:, :2] <= end_s).all(axis=1)]
    return {
        "direct": asdict(measure(of_direct, relations)),
        "emulated": asdict(measure(of_emulated, relations)),
        "counts": {
            name: json.loads((output / "mapping.json").read_text())
            for name, output in (("direct", direct), ("emulated", emulated))
        },
        "played": json.loads((emulated / "played.json").read_text()),
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the log."""
    parser.add_argument("--rate", type=float, default=4.0, help="how many times as fast as recorded")
    parser.add_argument("--seconds", type=float, default=None, help="play only this part of the log")
    intel.options(parser)


def play_both(case: Case) -> intel.Report:
    """Make both runs of a case."""
    chosen = case.options
    return compare(case.folder, case.prepared, chosen.rate, chosen.seconds) | {"violations": []}


SUBJECT = TrialSubject(
    play=lambda case: intel.report_of(partial(play_both, case)),
    options=options,
    prepare=intel.data_of,
    is_good=intel.is_clean,
    seeds=1,
    seed_makes="nothing: the log is always the same",
)
