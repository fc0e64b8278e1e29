"""Measures what a page that shows six live things costs other modules: `python -m tools.operator.beside`.

A robot has two cameras of 640 x 480 pixels at 10 Hz, a map of 1000 x 1000 cells of which a patch changes
each second, clouds of 50,000 points at 5 Hz, and a laser at 10 Hz. Its modules exchange 500 small messages a
second, whose latency is measured: without a station; with one and a page that takes all of this but draws
nothing, and only with the processor time that the robot leaves; and with a control in place of both. The
control has none of the station's code: for each thread of station and page, a process that wakes up as often
and computes as long, with the same priority and time slice.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import psutil

from tools.bench.contender import work_folder
from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.load.measure import latency_of
from tools.operator.light_pages import NICE
from tools.robot import REPOSITORY, Robot, running

WITHOUT, PAGE, CONTROL = "without", "page", "control"
GOAL = 1.2
PAIRS, TALK_HZ = 5, 100.0
SETTLE_S = 8.0
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


def profile(*, has_station: bool) -> dict[str, Any]:
    """Return the robot's profile."""
    modules: dict[str, Any] = {name: {"class": what} for name, what in ROBOT.items()}
    for number in range(PAIRS):
        listener = {"number": number}
        modules[f"listener{number}"] = {"class": "tools.load.modules:Listener", "settings": listener}
        talker = {"number": number, "rate_hz": TALK_HZ}
        modules[f"talker{number}"] = {"class": "tools.load.modules:Talker", "settings": talker}
    if has_station:
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


def measure(session: str, seconds: float, loads: list[ThreadLoad]) -> tuple[dict[str, Any], list[ThreadLoad]]:
    """Run the robot for a time. Return its figures, and with a page what station and page did meanwhile."""
    with work_folder() as (_, folder), ExitStack() as stack:
        (folder / "operator.token").touch(mode=0o600)
        (folder / "operator.token").write_text(TOKEN)
        robot = stack.enter_context(running(folder, profile(has_station=session == PAGE)))
        robot.wait_until_running()
        nice_of: dict[int, int] = {}
        if session == PAGE:
            nice_of = {robot.figures()["operator"].pid: 0, stack.enter_context(page_of(robot)): NICE}
        pids = stack.enter_context(imitated(loads)) if session == CONTROL else list(nice_of)
        time.sleep(SETTLE_S)
        assert robot.observer is not None
        before, used, used_s = robot.observer.read(), {pid: used_by(pid) for pid in nice_of}, cpu_s(pids)
        time.sleep(seconds)
        now, used_s = robot.observer.read(), cpu_s(pids) - used_s
        took_s = (now.at_ns - before.at_ns) / 1e9
        found = [
            load
            for pid, nice in nice_of.items()
            for load in loads_between(used[pid], used_by(pid), took_s, nice)
        ]
        small = latency_of(before, now, [f"listener{number}" for number in range(PAIRS)])
        return {"session": session, **small, "percent of a processor": 100 * used_s / took_s}, found


def as_table(results: list[dict[str, Any]]) -> str:
    """Return a table with a row for each session, and the ratios below it."""
    columns = ("p50_us", "p99_us", "percent of a processor")
    rows = [[one["session"], *(short_number(one[name]) for name in columns)] for one in results]
    lines = [render(["session", *columns], rows), ""]
    p99_us = {
        name: median(one["p99_us"] for one in results if one["session"] == name)
        for name in (WITHOUT, PAGE, CONTROL)
    }
    for name, other in ((PAGE, WITHOUT), (CONTROL, WITHOUT), (PAGE, CONTROL)):
        lines.append(f"p99, {name} ÷ {other}, medians: {p99_us[name] / p99_us[other]:.2f} (goal {GOAL})")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=40.0, help="duration of each session (40)")
    parser.add_argument("--rounds", type=int, default=5, help="number of rounds (5)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to this file")
    chosen = parser.parse_args(arguments)
    results: list[dict[str, Any]] = []
    loads: list[ThreadLoad] = []
    for _ in range(chosen.rounds):
        for session in (WITHOUT, PAGE, CONTROL):
            result, found = measure(session, chosen.seconds, loads)
            loads = found or loads
            results.append(result | {"threads": [asdict(one) for one in found]})
            print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    print(as_table(results))
    if chosen.json:
        report = {"machine": describe_machine(), "command": " ".join(sys.argv), "results": results}
        chosen.json.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
