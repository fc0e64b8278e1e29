"""Maps the Intel log directly and through emulated serial devices: are the trajectories equally good?

    python -m tools.intel_emulated [--rate 4] [--seconds N] [--data DIR] [--keep DIR] [--json]

The direct playback hands the recorded odometry and scans to mapping. In the other run an emulated Create 2
and an emulated SICK LMS2xx repeat the drive, and the drivers read their bytes. The error is that of
`tools.slam_metric`, with the same relations for both.
"""

import argparse
import json
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools.intel_lockstep import DATA
from tools.kill_campaign.robot import REPOSITORY, Robot, RobotTrouble
from tools.slam_metric import Score, measure, read_table

Array = NDArray[np.float64]

RUN_LIMIT_S = 3600.0
RECORDS = ("ODOM ", "FLASER ")


def play(profile: str, folder: Path, *settings: str) -> Path:
    """Run a profile to its end; return the folder of its output.

    Raises:
        RobotTrouble: the run failed.
    """
    words = [word for setting in settings for word in ("--set", setting)]
    robot = Robot(folder, REPOSITORY, profile, *words)
    try:
        limit_s = time.monotonic() + RUN_LIMIT_S
        while robot.is_up and time.monotonic() < limit_s:
            time.sleep(0.2)
        summary = robot.wait_for_end()
    finally:
        robot.close()
    if summary["exit_code"]:
        raise RobotTrouble(f"the run of {profile} has failed: {summary['reason']}")
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


def compare(folder: Path, data: Path, rate: float, seconds: float | None) -> dict[str, object]:
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


def as_text(report: dict[str, object]) -> str:
    """Return the errors as text."""
    lines = []
    for name in ("direct", "emulated"):
        errors = report[name]
        assert isinstance(errors, dict)
        score = Score(**errors)
        lines.append(
            f"{name}: {score.translation_mean_m:.4f} ± {score.translation_sd_m:.4f} m, "
            f"{score.rotation_mean_deg:.3f} ± {score.rotation_sd_deg:.3f} degrees, "
            f"{score.relations_used} relations"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. The exit code is 1 if a run failed, and 2 without the data."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.intel_emulated",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rate", type=float, default=4.0, help="how many times as fast as recorded")
    parser.add_argument("--seconds", type=float, default=None, help="play only this part of the log")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with intel.clf and intel.relations")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="new folder for the output of both runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    if not (options.data / "intel.clf").exists():
        print(f"intel_emulated: {options.data} has no intel.clf", file=sys.stderr)
        return 2
    folder = options.keep or Path(tempfile.mkdtemp(prefix="robbie-intel-"))
    folder.mkdir(exist_ok=True)
    try:
        report = compare(folder, options.data, options.rate, options.seconds)
    except RobotTrouble as trouble:
        print(f"intel_emulated: {trouble}", file=sys.stderr)
        return 1
    finally:
        if options.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
    print(json.dumps(report, indent=2) if options.json else as_text(report))
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
