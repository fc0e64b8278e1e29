"""Measures how long a killed module is away: `python -m tools.bench.restart [--kills 30] [--subject S]`.

The tool kills a module with SIGKILL again and again, while another module publishes at 100 Hz. It measures
the time until the restarted module enters the handler of its next message. The killed module is either a
small one that imports numpy, or the stock robot's mapping, which restores its map. The robot with mapping is
that of the profile `demo`, and its spares import what that profile names.
"""

import argparse
import contextlib
import json
import os
import select
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil

from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import ModuleSpec, Profile, RestartPolicy
from robbie_mp.run.supervisor.run import RunListener, run_profile
from robbie_mp.run.supervisor.states import ChildState, StateChange

SUBJECT = "subject"
CHECKOUT = Path(__file__).parents[2]
UNLIMITED = RestartPolicy(max_restarts=1 << 20, stable_after_s=0.0)
LIMIT_S = 30.0
PAUSE_S = 0.3
"""Time between a restart and the next kill."""
LOOK_EVERY_S = 0.005

STEPS = ("kill", "death", "BACKOFF", "STARTING", "import_begin", "import_end", "setup_end", "first_message")
PARTS = (
    "end in the kernel",
    "detection",
    "backoff and reclaim",
    "spawn or assign",
    "import of the class",
    "construction and setup",
    "first message",
)
"""The part of a restart between each two consecutive steps."""


class Campaign:
    """Kills a module repeatedly, and collects the times of each restart.

    Attributes:
        restarts: for each kill, the times of `STEPS` on the monotonic clock, in ns.
    """

    def __init__(self, kills: int, spares: int, folder: Path):
        """Prepare the campaign.

        Args:
            kills: number of kills.
            spares: number of warm spare interpreters to wait for before each kill.
            folder: the run's output directory.
        """
        self.restarts: list[dict[str, int]] = []
        self._kills = kills
        self._spares = spares
        self._folder = folder
        self._changes: dict[str, int] = {}
        self._ends = threading.Event()
        self.thread = threading.Thread(target=self._kill_repeatedly)

    def on_change(self, change: StateChange) -> None:
        """Record when the supervisor reports a state of the subject. The supervisor's thread calls this."""
        if change.name == SUBJECT:
            self._changes[change.new] = time.monotonic_ns()
            if change.new is ChildState.FAILED:
                self._ends.set()

    def _kill_repeatedly(self) -> None:
        try:
            pid = self._wait_for_first_message(set())
            for _ in range(self._kills):
                self._wait_until(self._are_spares_warm)
                self._ends.wait(PAUSE_S)
                seen = self._subjects()
                killed_ns, dead_ns = kill(pid)
                pid = self._wait_for_first_message(seen)
                times_ns = json.loads((self._folder / f"{pid}.json").read_text())
                self.restarts.append({"kill": killed_ns, "death": dead_ns, **self._changes, **times_ns})
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def _wait_for_first_message(self, seen: set[int]) -> int:
        """Wait until a new process of the subject has handled a message, and return its pid."""
        self._wait_until(lambda: bool(self._subjects() - seen))
        return (self._subjects() - seen).pop()

    def _subjects(self) -> set[int]:
        return {int(file.stem) for file in self._folder.glob("*.json") if file.stem.isdecimal()}

    def _are_spares_warm(self) -> bool:
        warm = 0
        for process in psutil.Process().children():
            with contextlib.suppress(psutil.NoSuchProcess):
                warm += process.name() == "spare"  # its name after the imports
        return warm >= self._spares

    def _wait_until(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + LIMIT_S
        while not condition():
            if time.monotonic() > deadline_s or self._ends.is_set():
                raise TimeoutError(f"the robot made no progress within {LIMIT_S:g} s")
            time.sleep(LOOK_EVERY_S)


def kill(pid: int) -> tuple[int, int]:
    """Kill a process. Return the times of the signal and of the end of the process."""
    pidfd = os.pidfd_open(pid)
    try:
        killed_ns = time.monotonic_ns()
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)
        select.select([pidfd], [], [])
        return killed_ns, time.monotonic_ns()
    finally:
        os.close(pidfd)


def small_robot() -> Profile:
    """Return the profile of a robot with two modules, one of which is killed."""
    where = f"{__package__}.restart_subject"
    return Profile(
        name="restart",
        modules=(
            ModuleSpec("source", f"{where}:Source"),
            ModuleSpec(SUBJECT, f"{where}:Subject", restart=UNLIMITED),
        ),
        workspace=CHECKOUT,
    )


def stock_robot() -> Profile:
    """Return the demo's profile without exploration and with odometry at 100 Hz. Mapping is killed."""
    where = f"{__package__}.restart_mapping"
    demo = load_profile("demo", CHECKOUT, ["base.period_s=0.01"])
    spec = {module.name: module for module in demo.modules}
    mapping = replace(spec["mapping"], name=SUBJECT, class_path=f"{where}:MappingSubject", restart=UNLIMITED)
    circling = ModuleSpec("circling", f"{where}:Circling")
    return replace(demo, name="restart", modules=(mapping, spec["base"], spec["laser"], circling))


ROBOTS = {"small": small_robot, "mapping": stock_robot}


def measure(profile: Profile, kills: int) -> list[dict[str, int]]:
    """Run the campaign and return the times of each restart."""
    with tempfile.TemporaryDirectory() as name:
        campaign = Campaign(kills, profile.spares.count, Path(name))
        campaign.thread.start()
        try:
            run_profile(profile, {}, (), Path(name), RunListener(change=campaign.on_change))
        finally:
            campaign.thread.join()
    return campaign.restarts


def summary(restarts: list[dict[str, int]]) -> dict[str, dict[str, float]]:
    """Return the median and 99th percentile of the whole time and of its parts, in ms."""
    at_ns = np.array([[restart[step] for step in STEPS] for restart in restarts])
    parts_ms = {
        part: (at_ns[:, end] - at_ns[:, begin]) / 1e6
        for part, (begin, end) in zip(PARTS, pairwise(range(len(STEPS))), strict=True)
    }
    parts_ms["kill to handler"] = (at_ns[:, -1] - at_ns[:, 0]) / 1e6
    return {
        part: {"median_ms": float(np.median(ms)), "p99_ms": float(np.quantile(ms, 0.99))}
        for part, ms in parts_ms.items()
    }


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.restart", description=__doc__)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--subject", choices=ROBOTS, default="small", help="the module to kill")
    parser.add_argument(
        "--spares", type=int, default=1, help="number of spare interpreters; 0: all starts are cold"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    robot = ROBOTS[arguments.subject]()
    robot = replace(robot, spares=replace(robot.spares, count=arguments.spares))
    restarts = measure(robot, arguments.kills)
    if len(restarts) < arguments.kills:
        print(f"only {len(restarts)} of {arguments.kills} restarts took place", file=sys.stderr)
        return 1
    figures = summary(restarts)
    if arguments.json:
        facts = {"subject": arguments.subject, "kills": len(restarts), "spares": arguments.spares}
        print(json.dumps({**facts, "parts": figures}, indent=2))
        return 0
    print(f"{len(restarts)} kills of {arguments.subject}, {arguments.spares} spares: median and p99 in ms")
    for part, values in figures.items():
        print(f"  {part:24} {values['median_ms']:8.1f} {values['p99_ms']:8.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
