"""Measures how soon the emergency stop of the page acts, and how soon a killed page server is back.

    python -m tools.operator.stops --repeats 20 --presses 200 --json FILE

A real Chromium (the system's, with Playwright) shows the page of a simulated robot: once on the machine as it
is, and once while all processors are busy. The times are the stamps of the base's own messages. How soon the
robot stands when page, server or link fail is measured by `tools.standstill`.
"""

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser

from tools.bench.machine import describe_machine
from tools.busy import busy
from tools.operator.chromium import chromium
from tools.operator.scene import Scene, scene

NOTE_PRESSES = """addEventListener("pointerdown", (event) => {
  window.age_ms = performance.now() - event.timeStamp;
  window.pressed_ms = Date.now() - window.age_ms;
}, true)"""
"""Records when the browser received the last press, and how much later the page's script received it."""
PAUSE_S = (0.05, 0.3)
"""Range of the random pause between two presses, so that they do not follow any period of the page."""
PAGE, SERVER, BASE = "the page has the press", "the server has published the stop", "the base begins to stop"
Times = dict[str, list[float]]


def press_trials(robot: Scene, browser: Browser, count: int) -> Times:
    """Press the emergency stop again and again; return the times (s) from each press to its effects."""
    chance = random.Random(count)
    found: Times = {PAGE: [], SERVER: [], BASE: []}
    with robot.page(browser, "127.0.0.1") as page:
        page.evaluate(NOTE_PRESSES)
        for _ in range(count):
            time.sleep(chance.uniform(*PAUSE_S))
            before_ns = time.monotonic_ns()
            page.click("#emergency-stop")
            wall_ahead_ns = time.time_ns() - time.monotonic_ns()
            pressed_ns = round(page.evaluate("window.pressed_ms") * 1e6) - wall_ahead_ns
            found[PAGE].append(page.evaluate("window.age_ms") / 1e3)
            found[BASE].append((robot.wait_for("stopped", 1.0, before_ns) - pressed_ns) / 1e9)
            found[SERVER].append((robot.wait_for("asked", 1.0, before_ns) - pressed_ns) / 1e9)
            robot.stop(engaged=False)
    return found


def return_trials(robot: Scene, browser: Browser, count: int) -> list[float]:
    """Return the times (s) from the server's death until the browser showed a change made after it."""
    found = []
    with robot.page(browser, "127.0.0.1") as page:
        for _ in range(count):
            robot.wait_for_spare()
            at_ns = robot.send("operator", signal.SIGKILL)
            robot.stop(engaged=True)
            page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
            found.append((time.monotonic_ns() - at_ns) / 1e9)
            robot.stop(engaged=False)
            page.wait_for_selector("#emergency-stop-state:has-text('ready')")
    return found


def measure(robot: Scene, repeats: int, presses: int) -> Iterator[tuple[str, list[float]]]:
    """Run all trials. Yield the name and the times (s) of each."""
    with chromium() as browser:
        for name, times_s in press_trials(robot, browser, presses).items():
            yield f"emergency stop pressed: {name}", times_s
        yield "server killed: the page shows the present state", return_trials(robot, browser, repeats)


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
    parser = argparse.ArgumentParser(
        prog="python -m tools.operator.stops",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--repeats", type=int, default=20, help="how often the server is killed (20)")
    parser.add_argument("--presses", type=int, default=200, help="presses of the emergency stop (200)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args()
    report: dict[str, Any] = {"machine": describe_machine()}
    with tempfile.TemporaryDirectory(prefix="robbie-operator-") as folder, scene(Path(folder)) as robot:
        for load, processes in (("idle", 0), ("busy processors", len(os.sched_getaffinity(0)))):
            with busy(processes):
                for name, times_s in measure(robot, options.repeats, options.presses):
                    report[f"{load}: {name}"] = summary(times_s)
                    print(f"{load}: {name}: {report[f'{load}: {name}']}", flush=True)
            if options.json:
                options.json.write_text(json.dumps(report, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
