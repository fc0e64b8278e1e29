"""Measures how soon the robot stops when the page, its server or the link to it fails.

    python -m tools.operator.stops --repeats 20 --presses 200 --json FILE
    python -m tools.operator.stops --layouts Mission,Tablet --loads idle --repeats 6 --presses 60

A real Chromium (the system's, with Playwright) drives a simulated robot through its operator station: once on
the machine as it is, and once while all processors are busy and mapping is killed every few seconds. The
times are the stamps of the base's own messages. The tool cuts the link in a network namespace, where that is
permitted.
"""

import argparse
import itertools
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser

from tools.bench.machine import describe_machine
from tools.operator.stops.chromium import CHROMIUM, chromium
from tools.operator.stops.cut_link import CutLink, cut_link, why_no_link
from tools.operator.stops.drives import EVENTS, cut_trials, trials
from tools.operator.stops.load import full_load
from tools.operator.stops.scene import CANNOT_DRIVE, LAYOUTS, Scene, scene
from tools.operator.stops.stops import press_trials, return_trials

LOADS = ("idle", "full load")
Figures = dict[str, dict[str, float]]


def measure(robot: Scene, browser: Browser, repeats: int, presses: int) -> Iterator[tuple[str, list[float]]]:
    """Run all trials that need no separate link. Yield the name and the times (s) of each."""
    pressed = press_trials(robot, browser, presses)
    yield "emergency stop pressed: the page has received the press", pressed.noticed
    yield "emergency stop pressed: the page server has published the stop", pressed.asked
    yield "emergency stop pressed: the base has a zero command", pressed.stopped
    yield "server killed: the page shows the present state", return_trials(robot, browser, repeats)
    for event in () if robot.layout in CANNOT_DRIVE else EVENTS:
        yield f"{event}: the robot stands", trials(robot, browser, event, repeats)


@contextmanager
def far_browser(link: CutLink, folder: Path) -> Iterator[Browser]:
    """Start a browser at the other end of the link."""
    with chromium(link.write_starter(str(CHROMIUM), folder / "far-chromium")) as browser:
        yield browser


def measure_cut(robot: Scene, folder: Path, repeats: int) -> Iterator[tuple[str, list[float]]]:
    """Run the trials with a cut link, if this machine allows one."""
    if robot.layout in CANNOT_DRIVE:
        return
    if problem := why_no_link():
        print(f"link cut: not measured, {problem}", file=sys.stderr)
        return
    with cut_link() as link, far_browser(link, folder) as browser:
        yield "link cut: the robot stands", cut_trials(robot, browser, link, repeats)


def summary(times_s: list[float]) -> dict[str, float]:
    """Return the statistics of a list of times."""
    p50, p99 = map(float, np.percentile(times_s, [50, 99]))
    return {
        "trials": len(times_s),
        "p50_ms": round(p50 * 1e3, 1),
        "p99_ms": round(p99 * 1e3, 1),
        "max_ms": round(max(times_s) * 1e3, 1),
    }


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.operator.stops", description=__doc__)
    parser.add_argument("--repeats", type=int, default=20, help="number of trials of each event")
    parser.add_argument("--presses", type=int, default=200, help="number of presses of the emergency stop")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    parser.add_argument(
        "--layouts", default=LAYOUTS[0], metavar="NAMES", help=f"layouts of the page, of {', '.join(LAYOUTS)}"
    )
    parser.add_argument("--loads", default=",".join(LOADS), metavar="NAMES", help="idle, full load, or both")
    options = parser.parse_args()
    layouts, loads = options.layouts.split(","), options.loads.split(",")
    if unknown := {*layouts} - {*LAYOUTS} | {*loads} - {*LOADS}:
        parser.error(f"there is no {', '.join(sorted(unknown))}")
    report: dict[str, Any] = {"machine": describe_machine()}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robbie-operator-")))
        robot = stack.enter_context(scene(folder))
        for load, layout in itertools.product(loads, layouts):
            figures: Figures = {}
            robot.layout = layout
            report[f"{load}, {layout}"] = figures
            with full_load(robot) if load == "full load" else nullcontext():
                with chromium() as browser:
                    for name, times_s in measure(robot, browser, options.repeats, options.presses):
                        show(f"{load}, {layout}", name, figures, times_s)
                for name, times_s in measure_cut(robot, folder, options.repeats):
                    show(f"{load}, {layout}", name, figures, times_s)
            if options.json:
                options.json.write_text(json.dumps(report, indent=2) + "\n")
    return 0


def show(load: str, name: str, figures: Figures, times_s: list[float]) -> None:
    """Record and print the times of one trial."""
    figures[name] = summary(times_s)
    print(f"{load}; {name}: {figures[name]}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
