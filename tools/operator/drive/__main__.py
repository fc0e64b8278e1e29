"""An operator in a browser drives through the rescue maze by keys, with what the layout Drive shows.

    python -m tools.operator.drive --json FILE

The operator is a program that uses a page in a real Chromium. It is told the coordinates of five places, sees
the map and the robot on it as the tile Map draws them, and holds W, A, S and D. Nothing else reaches the
robot, and the operator learns nothing but by the page. A witness says whether the robot really came to each
place.

First, the tool presses W again and again, and measures the time until the base moves.
"""

import argparse
import json
import math
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

from robbie_robots.hw.simulation.arena_file import read_arena
from tools.bench.machine import describe_machine
from tools.operator.drive.eyes import look
from tools.operator.drive.hands import Place, drive_to
from tools.operator.stops.__main__ import summary
from tools.operator.stops.chromium import chromium
from tools.operator.stops.scene import Scene
from tools.robot import REPOSITORY

ARENA = REPOSITORY / "hw" / "simulation" / "arenas" / "rescue_maze.yaml"
SPEED_M_PER_S = 0.5
IN_FRONT_M = 0.55
"""The places are this far in front of victims."""
TOUR = (4, 3, 5, 2, 6, 1)
"""The victims' tags in the order in which the operator is sent there."""
NEAR_M = 0.35
"""Maximum true distance of the robot from a place that it has reached."""
TAP_S = (0.12, 0.3)
"""Range of the pause between two presses of the key, so that they do not follow any period of the page."""
CAMERA = {
    "class": "robbie_robots.modules.devices.camera:SimulatedCameraModule",
    "settings": {
        "arena": str(ARENA),
        "period_s": 0.25,
        "width": 320,
        "height": 160,
        "field_of_view_rad": 1.4,
    },
}
NOTE_KEYS = """addEventListener("keydown", (event) => {
  window.pressed_ms = Date.now() - (performance.now() - event.timeStamp);
}, true)"""
"""Records when the browser received the last key."""


def places(count: int) -> list[Place]:
    """Return the places in the map frame, in which the robot starts at the origin, along its x axis."""
    arena = read_arena(ARENA)
    spots = {victim.tag: victim.spot for victim in arena.victims}
    return [
        (
            spots[tag].x_m + IN_FRONT_M * math.cos(spots[tag].facing_rad) - arena.start.x_m,
            spots[tag].y_m + IN_FRONT_M * math.sin(spots[tag].facing_rad) - arena.start.y_m,
        )
        for tag in TOUR[:count]
    ]


@contextmanager
def maze(folder: Path) -> Iterator[Scene]:
    """Start the robot in the maze. At the end, end it."""
    made = Scene(folder, ARENA, {"camera": CAMERA}, SPEED_M_PER_S)
    try:
        made.begin()
        yield made
    finally:
        made.close()


def key_trials(scene: Scene, page: Page, count: int) -> list[float]:
    """Press W and S in turn. Return the times (s) until the base moves."""
    chance = random.Random(count)
    found = []
    page.evaluate(NOTE_KEYS)
    for number in range(count):
        key = ("KeyW", "KeyS")[number % 2]
        time.sleep(chance.uniform(*TAP_S))
        before_ns = time.monotonic_ns()
        page.keyboard.down(key)
        wall_ahead_ns = time.time_ns() - time.monotonic_ns()
        pressed_ns = round(page.evaluate("window.pressed_ms") * 1e6) - wall_ahead_ns
        found.append((scene.wait_for("moving", 1.0, before_ns) - pressed_ns) / 1e9)
        page.keyboard.up(key)
        scene.wait_for("moving", 0.0)
    return found


def drive_round(scene: Scene, page: Page, wanted: list[Place], limit_s: float) -> list[dict[str, Any]]:
    """Drive to all places. Return for each what happened."""
    found = []
    for place in wanted:
        began_s = time.monotonic()
        says_there = drive_to(page, place, limit_s)
        away_m = math.dist(place, (scene.journal.newest("x"), scene.journal.newest("y")))
        took_s = round(time.monotonic() - began_s, 1)
        reached = says_there and away_m <= NEAR_M
        found.append({"place": place, "reached": reached, "away_m": round(away_m, 3), "took_s": took_s})
        print(found[-1], flush=True)
    return found


def measure(scene: Scene, browser: Browser, presses: int, count: int, limit_s: float) -> dict[str, Any]:
    """Open the layout Drive, and return all figures."""
    with scene.page(browser, "127.0.0.1") as page:
        page.keyboard.press("1")
        page.wait_for_selector("#layouts:has-text('Drive')")
        page.wait_for_function("document.querySelector('.camera-picture img')?.naturalWidth > 0")
        report: dict[str, Any] = {
            "key to motion": summary(key_trials(scene, page, presses)) if presses else None
        }
        print(report, flush=True)
        report["places"] = drive_round(scene, page, places(count), limit_s)
        report["camera in sight"] = look(page).camera_pixels > 0
        report["reached"] = sum(one["reached"] for one in report["places"])
        report["collisions"] = scene.robot.figures()["base"].status
    return report


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.operator.drive",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--presses", type=int, default=100, help="number of presses of a key")
    parser.add_argument("--places", type=int, default=5, help="number of places")
    parser.add_argument("--limit-s", type=float, default=60.0, help="maximum time for each place")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory(prefix="robbie-drive-") as folder,
        maze(Path(folder)) as scene,
        chromium() as browser,
    ):
        figures = measure(scene, browser, options.presses, options.places, options.limit_s)
    report = {"machine": describe_machine(), **figures}
    print(json.dumps(report, indent=1))
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    return 0 if figures["reached"] == options.places else 1


if __name__ == "__main__":
    sys.exit(main())
