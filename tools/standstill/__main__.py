"""Measures how soon a robot stands after a single failure, for every way to drive it.

    python -m tools.standstill --list
    python -m tools.standstill [--only WAY:FAILURE …] [--rounds N] [--busy] [--json FILE]
    python -m tools.standstill --json FILE --only nothing     # prints the table of what was measured

Stock robots drive in real time. When one has driven for a while, something fails, and the tool looks at
the robot's true motion. The robot must stand within 0.4 s (0.5 s with `--busy`), unless what failed is back
by then with fresh data, and must not move again on old data. Where the failure itself need not stop the robot
(a full disk, a clock that is set, a network that is a little slow), the time counts from the moment when,
meanwhile, the operator lets go or the laser of a robot that drives by itself stops.

Killed: SIGKILL; stopped: SIGSTOP; spinning: Python runs an expression that takes for ever with its global
lock held. `--only` takes shell patterns, such as `rescue:*` or `*:laser *`. Cells are added to those in the
file of `--json`. It ends with 1 if any cell of this call was late or not tried.

Not tried: the base and the supervisor, whose ends are the end of a simulated base; see docs/reliability.md.
"""

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from fnmatch import fnmatch
from itertools import groupby
from pathlib import Path

from playwright.sync_api import Error

from robbie_mp import RobbieError
from tools.robot import RobotTrouble
from tools.standstill.failures import Failure, failures_of
from tools.standstill.judgement import TrueMotion, judge
from tools.standstill.scene import IN_FLIGHT_S, NotDriving, TrialRobot
from tools.standstill.table import Cell, summary, table
from tools.standstill.ways import WAYS, DrivingWay
from tools.test_network.network import NoTestNetwork

LIMIT_S, BUSY_LIMIT_S = 0.4, 0.5
SETTLES_S, SETTLES_LIMIT_S = 1.5, 8.0
"""After this time of a failure that the robot may drive through, somebody lets go."""
ARRIVES_S, ARRIVES_LIMIT_S = 1.0, 8.0
"""After the watch, for what a stopped core has held back; longer as long as the motion has not arrived."""
TROUBLES = (NotDriving, RobotTrouble, NoTestNetwork, RobbieError, OSError, subprocess.SubprocessError, Error)
HOOK = Path(__file__).parent / "hook"


def measure(scene: TrialRobot, way: DrivingWay, failure: Failure, limit_s: float) -> TrueMotion:
    """Let something fail while the robot drives."""
    scene.wait_until_it_drives()
    output = scene.output_of(failure.role) if failure.role else None
    failed_s = time.monotonic()
    failure.begins(scene)
    if failure.lets_go:
        time.sleep(SETTLES_S)
        with suppress(NotDriving):  # the failure itself may stop it now and then
            scene.wait_until_it_drives(SETTLES_LIMIT_S)
        scene.send(way.dead_man, signal.SIGSTOP)
    if failure.lets_go or failure.role:
        failed_s = scene.sent_s
    time.sleep(failure.watch_s)
    until_s = time.monotonic()
    if failure.lets_go:
        scene.send(way.dead_man, signal.SIGCONT)
    failure.ends(scene)
    time.sleep(ARRIVES_S)
    scene.wait_for_motion(until_s, ARRIVES_LIMIT_S)
    fresh_s = math.inf
    if output:
        fresh_s = output.first_after(scene.done_s + IN_FLIGHT_S)
        output.close()
    return judge(scene.motion(), failed_s, fresh_s if fresh_s < until_s else math.inf, until_s, limit_s)


def measure_way(name: str, failures: Mapping[str, Failure], limit_s: float) -> Iterator[Cell]:
    """Try failures one after the other, on one run as long as it drives."""
    way = WAYS[name]
    for _, group in groupby(failures.items(), key=lambda item: item[1].prepared):
        left = list(group)
        while left:
            tried = 0
            try:
                with _started(way, left[0][1]) as scene:
                    while left:
                        motion = measure(scene, way, left[0][1], limit_s)
                        failure_name, failure = left.pop(0)
                        tried += 1
                        yield Cell(name, failure_name, motion, "", os.getloadavg()[0], limit_s)
                        if failure.is_final:
                            break
            except TROUBLES as trouble:
                if not tried and left:
                    failure_name, _ = left.pop(0)
                    yield Cell(name, failure_name, None, str(trouble)[-300:], os.getloadavg()[0], limit_s)


@contextmanager
def _started(way: DrivingWay, failure: Failure) -> Iterator[TrialRobot]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robbie-standstill-")))
        stack.enter_context(failure.prepared(folder))
        yield stack.enter_context(way.opens(folder))


@contextmanager
def load(is_wanted: bool) -> Iterator[None]:
    """Keep all processors busy."""
    made = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in os.sched_getaffinity(0)
        if is_wanted
    ]
    try:
        yield
    finally:
        for one in made:
            one.kill()
            one.wait()


def wanted(patterns: Sequence[str]) -> dict[str, dict[str, Failure]]:
    """Return the failures that patterns choose, by way."""
    found = {name: failures_of(name, way) for name, way in WAYS.items()}
    return {
        name: {key: one for key, one in some.items() if any(fnmatch(f"{name}:{key}", p) for p in patterns)}
        for name, some in found.items()
    }


def read_cells(file: Path | None) -> list[Cell]:
    """Return the cells of a file; none if there is no file."""
    if file is None or not file.exists():
        return []
    return [
        Cell(**{**row, "motion": TrueMotion(**row["motion"]) if row["motion"] else None})
        for row in json.loads(file.read_text())
    ]


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.standstill",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", default=["*"], metavar="WAY:FAILURE", help="shell patterns")
    parser.add_argument("--list", action="store_true", help="print all cells, and measure nothing")
    parser.add_argument("--rounds", type=int, default=1, help="how often each cell is measured")
    parser.add_argument("--busy", action="store_true", help="keep all processors busy meanwhile")
    parser.add_argument("--json", type=Path, metavar="FILE", help="add the cells to this file")
    arguments = parser.parse_args()
    chosen = wanted(arguments.only)
    if arguments.list:
        print("\n".join(f"{name}:{key}" for name, some in chosen.items() for key in some))
        return 0
    path = os.pathsep.join([str(HOOK), *filter(None, [os.environ.get("PYTHONPATH")])])
    os.environ["PYTHONPATH"] = path
    cells, new = read_cells(arguments.json), list[Cell]()
    with load(arguments.busy):
        for _ in range(arguments.rounds):
            for name, failures in chosen.items():
                for cell in measure_way(name, failures, BUSY_LIMIT_S if arguments.busy else LIMIT_S):
                    new.append(cell)
                    print(
                        f"{cell.way}: {cell.failure}: {cell.text} {cell.trouble}", file=sys.stderr, flush=True
                    )
                    if arguments.json:
                        arguments.json.write_text(json.dumps([asdict(one) for one in cells + new], indent=1))
    if cells + new:
        print(table(cells + new), summary(cells + new), sep="\n\n")
    return int(not all(cell.keeps for cell in new))


if __name__ == "__main__":
    sys.exit(main())
