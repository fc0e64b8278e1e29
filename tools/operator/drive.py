"""Drives the rescue robot by hand through its maze over slow networks: what is reached, touched, and when.

    python -m tools.operator.drive --mbit 20 5 1 0.3 --json FILE

A simulated robot and a real Chromium are on two hosts of a test network (root). The operator is a script that
has a plan of the maze. It sees only what the page shows: where the robot is on the map, the ring of free
distances, the speed, and the age of the picture. It acts only by keys. What was reached and touched is judged
by the truth of the simulation.
"""

import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page

from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.differential_drive import RobotBody
from robbie_robots.workers.planar_pose import transform_points
from tools.operator.chromium import chromium_by
from tools.operator.scene import Scene
from tools.operator.video import conditions
from tools.robot import REPOSITORY, stopping
from tools.test_network.network import DEVICE, Host, Network

MAZE = REPOSITORY / "hw" / "simulation" / "arenas" / "rescue_maze.yaml"
LANE_M = 1.5
WAY = ((0, 3), (1, 3), (1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (5, 2))
"""The corners of the way by the plan of the maze, in lanes to the right of the start and above it."""
PLACES = ((0, 3), (1, 0), (2, 1), (3, 2), (5, 2))
"""Those at which the operator stops."""
REACHED_M = 0.3
CHANGES = {"mission": None, "base": {"settings": {"true_path": True}}}
"""Nobody but the operator drives."""
TOP_M_PER_S = 0.7
LAYOUT = "Tablet"
"""Camera, map and pad: Chromium has no graphics card here, and would draw the 3-D view with the processor."""
LEG_LIMIT_S = 120.0
LOOK_MS, SETTLE_MS, AGAIN_MS = 100, 600, 300
AHEAD, BACK, LEFT, RIGHT = "KeyW", "KeyS", "KeyA", "KeyD"
NEAR_M = 0.15
CLOSE_M = 0.2
"""Nearer to what is ahead, the operator drives back."""
BACK_MS = 500
TURN_FIRST_RAD, CORRECT_RAD = 0.5, 0.1
TURN_RAD_PER_S, TURN_SHARE, MAX_TURN_MS = 0.75, 0.8, 1500.0
"""A turn is a little less than what is missing, because the operator sees it late."""
STANDS_S = 1.5
LOOK = """() => {
  const text = (what) => document.querySelector(what)?.textContent ?? "";
  const arcs = [...document.querySelectorAll("#hud-ring path")];
  const map = document.querySelector("#map-view")?.parentElement;
  return {
    map: text("#map-text"),
    speed: text("#velocity"),
    age_s: parseFloat(text(".camera-picture .picture-age")),
    map_age_s: parseFloat(map?.dataset.age?.match(/[\\d.]+/)) || 1.0,
    ring: Object.fromEntries(arcs.map(({ dataset }) => [dataset.at, parseFloat(dataset.m)])),
    touches: text("#hud-bumper"),
    why: [text("#control-who"), text("#control-why"), text("#control-link"), text(".hud-hint")].join("; "),
  };
}"""
TRAFFIC = """(() => {
  const bytes = (window.bytes_of = {}), trips = (window.trips_ms = []);
  const Plain = window.WebSocket;
  window.WebSocket = class extends Plain {
    constructor(...to) {
      super(...to);
      const kind = new URL(this.url).pathname.split("/").at(-1) || "state";
      const count = ({ data }) => (bytes[kind] = (bytes[kind] ?? 0) + (data.byteLength ?? data.length));
      this.addEventListener("message", count);
    }
  };
  addEventListener("robbie-link", ({ detail }) => trips.push(detail.age_ms));
})()"""
"""Counts bytes (of a text, characters) of each kind of connection; notes the age of the page's link, ms."""
KINDS = {"video": "pictures", "marks+map": "map", "state": "states", "emergency-stop": "stop"}
BEGIN = "() => { window.trips_ms.length = 0; for (const kind in window.bytes_of) window.bytes_of[kind] = 0; }"
RECEIVED = re.compile(rf"{DEVICE}: *(\d+)")
POSE = re.compile(r"robot at (-?[\d.]+) m, (-?[\d.]+) m, (\d+)°")
SPEED = re.compile(r"(-?[\d.]+) m/s, (-?[\d.]+) rad/s")
Place = tuple[float, float]


class NotReached(RuntimeError):
    """The operator does not get to a place."""


@dataclass(frozen=True)
class Sight:
    """What the page shows.

    Attributes:
        pose: x, y (m) and heading (rad) of the robot on the map.
        speed: m/s and rad/s.
        ahead_m: free distance ahead, from the ring.
        age_s: of the picture.
        touches: whether the bumper touches something.
        why: what the page says of the driving: who drives, how late it is, and why the robot stands.
    """

    pose: tuple[float, float, float]
    speed: tuple[float, float]
    ahead_m: float
    age_s: float
    touches: bool
    why: str

    @classmethod
    def of(cls, shown: dict[str, Any]) -> "Sight | None":
        """Return what a page shows; None while it does not show where the robot is, and how fast."""
        pose, speed = POSE.search(shown["map"]), SPEED.search(shown["speed"])
        if pose is None or speed is None:
            return None
        x_m, y_m, heading_deg = map(float, pose.groups())
        linear, angular = map(float, speed.groups())
        ahead_m = shown["ring"].get("ahead", math.nan)
        return cls(
            (x_m, y_m, math.radians(heading_deg)),
            (linear, angular),
            ahead_m,
            shown["age_s"],
            bool(shown["touches"]),
            shown["why"],
        )

    @property
    def stands(self) -> bool:
        """Whether the robot does not move."""
        return self.speed == (0.0, 0.0)

    def towards(self, place: Place) -> tuple[float, float]:
        """Return how far a place is (m), and how far to the left of ahead (rad)."""
        x_m, y_m, heading_rad = self.pose
        off_rad = math.atan2(place[1] - y_m, place[0] - x_m) - heading_rad
        return math.dist(place, (x_m, y_m)), math.remainder(off_rad, 2 * math.pi)


class KeyboardOperator:
    """Drives by the keys of a page, by what it shows.

    Attributes:
        ages_s: of the pictures that it saw.
        map_ages_s: of the robot's position on the map; up to 1 s, the page does not show it.
        touches: how often it saw that the bumper touched something.
        holds: how often it took hold again because the robot stood.
    """

    def __init__(self, page: Page):
        self._page = page
        self._held: tuple[str, ...] = ()
        self._moved_s = self._corrected_s = time.monotonic()
        self.ages_s: list[float] = []
        self.map_ages_s: list[float] = []
        self.touches = 0
        self.holds = 0

    def look(self) -> Sight:
        """Return what the page shows, after a moment."""
        until_s = time.monotonic() + LEG_LIMIT_S
        while time.monotonic() < until_s:
            self._page.wait_for_timeout(LOOK_MS)
            shown = self._page.evaluate(LOOK)
            sight = Sight.of(shown)
            if sight is not None:
                self.ages_s.append(sight.age_s)
                self.map_ages_s.append(shown["map_age_s"])
                self.touches += sight.touches
                return sight
        raise NotReached("the page does not show where the robot is")

    def hold(self, *keys: str, ms: float = 0.0) -> None:
        """Hold these keys and no others, for some time at least."""
        for key in self._held:
            if key not in keys:
                self._page.keyboard.up(key)
        for key in keys:
            if key not in self._held:
                self._page.keyboard.down(key)
        if not self._held:
            self._moved_s = time.monotonic()
        self._held = keys
        if ms:
            self._page.wait_for_timeout(ms)

    def turn(self, off_rad: float, *others: str) -> None:
        """Turn by almost that, to the left, while other keys are held."""
        ms = min(MAX_TURN_MS, 1e3 * TURN_SHARE * abs(off_rad) / TURN_RAD_PER_S)
        self.hold(*others, LEFT if off_rad > 0 else RIGHT, ms=ms)
        self.hold(*others)
        self._corrected_s = time.monotonic()

    def stand(self) -> None:
        """Let go, and wait until the page shows that the robot stands."""
        self.hold(ms=SETTLE_MS)
        while not self.look().stands:
            pass

    def drive_to(self, place: Place) -> None:
        """Drive to a place."""
        until_s = time.monotonic() + LEG_LIMIT_S
        while (way := (sight := self.look()).towards(place))[0] > NEAR_M:
            if time.monotonic() > until_s:
                raise NotReached(f"{place} is still {way[0]:.1f} m away: {sight.why}")
            self._steer(sight, way[1])
        self.stand()

    def _steer(self, sight: Sight, off_rad: float) -> None:
        now_s = time.monotonic()
        if not sight.stands or not self._held:
            self._moved_s = now_s
        if now_s - self._moved_s > STANDS_S:  # such as after the network was too slow to drive
            print(f"takes hold again: {sight.why}", file=sys.stderr, flush=True)
            self.holds += 1
            self.hold(ms=AGAIN_MS)
        elif abs(off_rad) > TURN_FIRST_RAD:
            self.stand()
            self.turn(off_rad)
            self.stand()
        elif sight.ahead_m < CLOSE_M:
            self.stand()
            self.hold(BACK, ms=BACK_MS)
            self.stand()
        else:
            self.hold(AHEAD)
            if abs(off_rad) > CORRECT_RAD and now_s - self._corrected_s > SETTLE_MS / 1e3:
                self.turn(off_rad, AHEAD)


def drive(page: Page) -> tuple[list[tuple[float, Place]], KeyboardOperator]:
    """Drive the whole way. Return when (s since 1970) the operator was at which place."""
    operator, arrivals = KeyboardOperator(page), []
    page.bring_to_front()
    operator.stand()
    for corner in WAY:
        there = (LANE_M * corner[0], LANE_M * corner[1])
        try:
            operator.drive_to(there)
        except NotReached as error:
            print(f"lost: {error}", file=sys.stderr)
            operator.hold()
            break
        if corner in PLACES:
            arrivals.append((time.time(), there))
            print(f"at {there}", file=sys.stderr, flush=True)
    return arrivals, operator


def judge(arrivals: Sequence[tuple[float, Place]], truth: NDArray[np.float64]) -> dict[str, float]:
    """Return what was reached, by the true path.

    Args:
        arrivals: when (s since 1970) the operator was at which place, as the page showed it.
        truth: rows of the time (s since 1970), x, y (m) and heading on the map.
    """
    arena = read_arena(MAZE)
    from_middle_m = arena.clearance_m(transform_points(arena.start, truth[:, 1:3]))
    errors_m = [math.dist(place, truth[np.abs(truth[:, 0] - at_s).argmin(), 1:3]) for at_s, place in arrivals]
    return {
        "reached": sum(error_m <= REACHED_M for error_m in errors_m),
        "greatest error, m": max(errors_m, default=math.nan),
        "least free distance, m": float(from_middle_m.min()) - RobotBody.STOCK.drive.body_radius_m,
        "way, m": float(np.hypot(*np.diff(truth[:, 1:3], axis=0).T).sum()),
    }


def received_bytes(host: Host) -> int:
    """Return how many bytes a host has received from the network so far, with all headers."""
    shown = subprocess.run(host.command("cat", "/proc/net/dev"), capture_output=True, text=True, check=True)
    found = RECEIVED.search(shown.stdout)
    assert found
    return int(found[1])


def measure(folder: Path, network: Network, browser: Browser) -> dict[str, float]:
    """Start a robot and drive it."""
    robot, laptop = network.host("robot"), network.host("laptop")
    scene = Scene(folder, MAZE, CHANGES, TOP_M_PER_S, on_host=robot.command(), parents=("robbie:rescue",))
    with stopping(scene.robot):
        scene.begin()
        with scene.page(browser, robot.address, LAYOUT, TRAFFIC) as page:
            begin_s, before = time.time(), received_bytes(laptop)
            page.evaluate(BEGIN)
            arrivals, operator = drive(page)
            took_s, line_bytes = time.time() - begin_s, received_bytes(laptop) - before
            bytes_of, trips_ms = page.evaluate("[window.bytes_of, window.trips_ms]")
        scene.robot.stop()
    counted = json.loads((scene.robot.output / "base.json").read_text())
    return {
        **judge(arrivals, np.loadtxt(scene.robot.output / "truth.txt")),
        "contacts": counted["collisions"],
        "touches seen": operator.touches,
        "s until the last place": (arrivals[-1][0] if arrivals else math.nan) - begin_s,
        "took hold again": operator.holds,
        "picture age p50, s": float(np.nanmedian(operator.ages_s)),
        "picture age p95, s": float(np.nanpercentile(operator.ages_s, 95)),
        "picture age max, s": float(np.nanmax(operator.ages_s)),
        "map age p95, s": float(np.percentile(operator.map_ages_s, 95)),
        "map age max, s": max(operator.map_ages_s),
        "round trip p50, s": float(np.median(trips_ms)) / 1e3,
        "round trip p95, s": float(np.percentile(trips_ms, 95)) / 1e3,
        **{f"{name}, kB/s": bytes_of.get(kind, 0) / 1e3 / took_s for kind, name in KINDS.items()},
        "all with headers, kB/s": line_bytes / 1e3 / took_s,
        "load": os.getloadavg()[0],
    }


def main(arguments: Sequence[str]) -> None:
    """Drive at each rate, and print a line of figures for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mbit", type=float, nargs="+", default=[20.0, 5.0, 1.0, 0.3])
    parser.add_argument("--round-trip-ms", type=float, default=80.0)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(arguments)
    found = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        Network("robot", "laptop") as network,
        chromium_by(network.host("laptop").command(), Path(folder)) as browser,
    ):
        for mbit in chosen.mbit:
            network.set(conditions(mbit, chosen.round_trip_ms))
            found[mbit] = measure(Path(folder) / f"{mbit}", network, browser)
            rounded = {name: round(value, 2) for name, value in found[mbit].items()}
            print(f"{mbit} Mbit/s:", rounded, flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main(sys.argv[1:])
