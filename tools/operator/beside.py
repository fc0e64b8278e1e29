"""Measures what a page that shows six live things costs other modules: `python -m tools.operator.beside`.

A robot has two cameras of 640 x 480 pixels at 10 Hz, a map of 1000 x 1000 cells of which a patch changes
each second, clouds of 50,000 points at 5 Hz, and a laser at 10 Hz. Its modules exchange 500 small messages a
second, whose latency is measured: while no page is open; with one that takes all of this but draws nothing,
and only with the processor time that the robot leaves; and with a control in its place. The control has none
of the station's code: for each thread of station and page, a process that wakes up as often and computes as
long, with the same priority and time slice.

What else happens on a machine changes a p99 several times within a minute. So the three take turns of some
seconds in one robot, and all messages of each count together.
"""

import argparse
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from robbie_mp.bus.transport.histogram import quantile_s
from tools.bench.contender import work_folder
from tools.bench.table import render, short_number
from tools.load.measure import histogram_of
from tools.operator.light_pages import NICE
from tools.robot import REPOSITORY, Robot, running

WITHOUT, PAGE, CONTROL = "without", "page", "control"
GOAL = 1.2
PAIRS, TALK_HZ = 5, 100.0
SETTLE_S = 1.5
TOKEN = "watches-six-things-at-once"
LAYOUT = "Live"
TILES = {
    "camera": [0, 0, 12, 12],
    "view": [12, 0, 12, 12],
    "map": [0, 12, 8, 12],
    "system": [8, 12, 8, 12],
    "trace": [16, 12, 8, 12],
}
"""Six things are live: both cameras are in one tile."""
CAMERAS = ("camera", "second_camera")
ROBOT = {
    "rover": "tools.operator.watched_robot:Rover",
    "mapping": "tools.operator.watched_robot:MapMaker",
    "depth": "tools.operator.watched_robot:DepthCamera",
    "camera": "tools.operator.moving_camera:MovingCamera",
    "second_camera": "tools.operator.watched_robot:SecondCamera",
}
STATION_SLICE_MS = 100.0
IMITATE = """
import logging, os, random, sys, threading, time
from robbie_mp.base.linux.priority import lower_priority, set_time_slice
share, wakes_hz, nice, slice_ms = map(float, sys.argv[1:])
if nice: lower_priority(int(nice), logging.getLogger())
else: set_time_slice(slice_ms, logging.getLogger())
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0)), daemon=True).start()
due_s = time.monotonic()
while True:
    due_s = max(due_s, time.monotonic() - 1.0) + random.expovariate(wakes_hz)
    time.sleep(max(0.0, due_s - time.monotonic()))
    until_s = time.thread_time() + share / wakes_hz
    while time.thread_time() < until_s: pass
"""
"""It ends with its input, and so with this program."""
LEAST_WAKES_HZ = 0.2
"""A thread that wakes up more rarely is not imitated."""


@dataclass(frozen=True)
class ThreadLoad:
    """What a thread does to the processors.

    Attributes:
        share: of one processor.
        wakes_hz: how often it wakes up.
        nice: of its process.
    """

    share: float
    wakes_hz: float
    nice: int


@dataclass(frozen=True)
class SessionPart:
    """Some seconds in which nothing changed.

    Attributes:
        session: `WITHOUT`, `PAGE` or `CONTROL`.
        counts: `(HISTOGRAM_BUCKETS,)`, the latencies of the small messages.
        percent: of a processor, of station and page, or of the control.
    """

    session: str
    counts: NDArray[np.int64]
    percent: float


def profile() -> dict[str, Any]:
    """Return the robot's profile."""
    modules: dict[str, Any] = {name: {"class": what} for name, what in ROBOT.items()}
    for number in range(PAIRS):
        listener = {"number": number}
        modules[f"listener{number}"] = {"class": "tools.load.modules:Listener", "settings": listener}
        talker = {"number": number, "rate_hz": TALK_HZ}
        modules[f"talker{number}"] = {"class": "tools.load.modules:Talker", "settings": talker}
    own = {"port": 0, "layouts": {LAYOUT: TILES}, "operator_token": "file:operator.token"}
    modules["operator"] = {"class": "robbie_mp.station:OperatorStation", "settings": own}
    return {"modules": modules}


def used_by(pid: int) -> dict[int, tuple[float, int]]:
    """Return for each thread of a process its processor time (s), and how often it has slept so far."""
    found = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        try:
            run_ns = int((thread / "schedstat").read_text().split()[0])
            slept = re.search(r"^voluntary_ctxt_switches:\s+(\d+)", (thread / "status").read_text(), re.M)
        except FileNotFoundError:
            continue  # it has ended
        found[int(thread.name)] = run_ns / 1e9, int(slept[1]) if slept else 0
    return found


def loads_between(
    before: Mapping[int, tuple[float, int]], now: Mapping[int, tuple[float, int]], took_s: float, nice: int
) -> list[ThreadLoad]:
    """Return what the threads of a process did between two looks."""
    found = []
    for thread, (used_s, slept) in now.items():
        used_before_s, slept_before = before.get(thread, (0.0, 0))
        wakes_hz = (slept - slept_before) / took_s
        if wakes_hz >= LEAST_WAKES_HZ:
            found.append(ThreadLoad((used_s - used_before_s) / took_s, wakes_hz, nice))
    return found


@contextmanager
def page_of(robot: Robot) -> Iterator[int]:
    """Open a page that draws nothing, and yield the pid of its process."""
    status = ""

    def has_address() -> bool:
        nonlocal status
        status = robot.figures()["operator"].status
        return "http://" in status

    robot.wait_for(has_address, "there is no page")
    (address,) = re.findall(r"http://\S+/", status)
    command = [sys.executable, "-m", "tools.operator.light_pages", address, TOKEN, LAYOUT, *CAMERAS]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=REPOSITORY, start_new_session=True, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        if process.stdout.readline() != "ready\n":
            raise RuntimeError("the page did not open")
        yield process.pid
        print("what the page has got:", ask(process), file=sys.stderr, flush=True)
        process.stdin.close()


def ask(process: "subprocess.Popen[str]") -> str:
    """Return how many packets a page has got."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


@contextmanager
def imitated(loads: list[ThreadLoad]) -> Iterator[list[int]]:
    """Run a process for each thread, and yield their pids."""
    made: list[subprocess.Popen[bytes]] = []
    try:
        for load in loads:
            words = map(str, (load.share, load.wakes_hz, load.nice, STATION_SLICE_MS))
            command = [sys.executable, "-c", IMITATE, *words]
            pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "start_new_session": True}
            made.append(subprocess.Popen(command, cwd=REPOSITORY, **pipes))
        yield [one.pid for one in made]
    finally:
        for one in made:
            one.kill()
            one.communicate()


def cpu_s(pids: list[int]) -> float:
    """Return the processor time of processes, s."""
    times = [psutil.Process(pid).cpu_times() for pid in pids]
    return sum(one.user + one.system for one in times)


def measure(rounds: int, seconds: float) -> Iterator[SessionPart]:
    """Run one robot, and yield what its modules needed without a page, with one, and with the control."""
    with work_folder() as (_, folder):
        (folder / "operator.token").touch(mode=0o600)
        (folder / "operator.token").write_text(TOKEN)
        with running(folder, profile()) as robot:
            robot.wait_until_running()
            station = robot.figures()["operator"].pid
            for _ in range(rounds):
                yield part(robot, WITHOUT, [station], seconds)
                with page_of(robot) as page:
                    used, used_ns = {pid: used_by(pid) for pid in (station, page)}, time.monotonic_ns()
                    yield part(robot, PAGE, [station, page], seconds)
                    took_s = (time.monotonic_ns() - used_ns) / 1e9
                    loads = loads_between(used[station], used_by(station), took_s, 0)
                    loads += loads_between(used[page], used_by(page), took_s, NICE)
                with imitated(loads) as pids:
                    yield part(robot, CONTROL, pids, seconds)


def part(robot: Robot, session: str, pids: list[int], seconds: float) -> SessionPart:
    """Wait until the robot is used to what has just changed, and measure."""
    assert robot.observer is not None
    listeners = [f"listener{number}" for number in range(PAIRS)]
    time.sleep(SETTLE_S)
    before, used_s = histogram_of(robot.observer.read(), listeners), cpu_s(pids)
    time.sleep(seconds)
    now, used_s = histogram_of(robot.observer.read(), listeners), cpu_s(pids) - used_s
    return SessionPart(session, now.counts - before.counts, 100 * used_s / seconds)


def as_table(parts: list[SessionPart]) -> str:
    """Return a table with a row for each session, of all its messages together, and the ratios below it."""
    rows, p99_us = [], {}
    for name in (WITHOUT, PAGE, CONTROL):
        own = [one for one in parts if one.session == name]
        counts = np.sum([one.counts for one in own], axis=0)
        p50_us, p99_us[name] = (quantile_s(counts, fraction) * 1e6 for fraction in (0.5, 0.99))
        figures = (int(counts.sum()), p50_us, p99_us[name], median(one.percent for one in own))
        rows.append([name, *map(short_number, figures)])
    lines = [render(["session", "messages", "p50_us", "p99_us", "percent of a processor"], rows), ""]
    for name, other in ((PAGE, WITHOUT), (CONTROL, WITHOUT), (PAGE, CONTROL)):
        lines.append(f"p99, {name} ÷ {other}: {p99_us[name] / p99_us[other]:.2f} (goal {GOAL})")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="duration of each session (5)")
    parser.add_argument("--rounds", type=int, default=20, help="how often each session comes (20)")
    chosen = parser.parse_args(arguments)
    print(as_table(list(measure(chosen.rounds, chosen.seconds))))


if __name__ == "__main__":
    main()
