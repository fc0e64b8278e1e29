"""Runs the robot once, with or without its operator's page, and returns the figures."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any

import psutil
import yaml

from robbie_mp.bus.observe.figures import RunReading
from robbie_mp.bus.observe.rates import rates_between
from tools.bench.contender import work_folder
from tools.bench.processes import family
from tools.load.logger.measure import latency_of
from tools.load.operator import HIDDEN, LIVE, ROLES, TILES, token_of
from tools.load.operator.narrow_link import NarrowLink, narrow_link
from tools.robot import REPOSITORY, Robot

Result = dict[str, Any]
Counts = list[dict[str, float]]

MODULES = "tools.load.operator.modules"
OPERATOR = "operator"
PAIRS = 5
TALK_HZ = 100.0
SETTLE_S = 5.0
SAMPLE_S = 1.0
LIVE_TILES = {
    "camera": [0, 0, 12, 12],
    "view": [12, 0, 12, 12],
    "map": [0, 12, 8, 12],
    "system": [8, 12, 8, 12],
    "trace": [16, 12, 8, 12],
}
"""Six things are live: both cameras are in one tile."""
ALL_COUNTED = ("view", "frames", "map", "cameras", "system", "trace")
COUNTED = {"view": ("view", "frames")} | dict.fromkeys((TILES, HIDDEN, "parameters"), ALL_COUNTED)
"""What is counted on pages with several things."""
_BROWSER = [sys.executable, "-m", "tools.load.operator.browser_pages"]
KINDS = {
    "browser": _BROWSER,
    "elsewhere": [*_BROWSER, "--elsewhere"],
    "light": [sys.executable, "-m", "tools.load.operator.light_pages"],
}


@dataclass(frozen=True)
class Session:
    """The conditions of one measurement.

    Args:
        name: name of the row.
        has_station: whether the robot has an operator station.
        kind: kind of the pages, see KINDS.
        tabs: the tab of each page.
        slow_bytes_per_s: rate of an additional page's link; None: there is none; 0: the link carries no data.
        is_dragged: whether a mouse drags and zooms in the pages after the other measurements.
    """

    name: str
    has_station: bool = True
    kind: str = "light"
    tabs: tuple[str, ...] = ()
    slow_bytes_per_s: float | None = None
    is_dragged: bool = False


def profile(has_station: bool, cells: int, points: int) -> dict[str, Any]:
    """Return the robot's profile."""
    modules: dict[str, Any] = {
        "rover": {"class": f"{MODULES}:Rover"},
        "mapping": {"class": f"{MODULES}:MapMaker", "settings": {"cells": cells}},
        "depth": {"class": f"{MODULES}:DepthCamera", "settings": {"points": points}},
        "left": {"class": f"{MODULES}:Camera", "settings": {"place": "left"}},
        "right": {"class": f"{MODULES}:Camera", "settings": {"place": "right"}},
        "viewer": {"class": "tools.load.logger.modules:Viewer"},
    }
    for number in range(PAIRS):
        settings = {"number": number, "rate_hz": TALK_HZ}
        modules[f"listener{number}"] = {
            "class": "tools.load.logger.modules:Listener",
            "settings": {"number": number},
        }
        modules[f"talker{number}"] = {"class": "tools.load.logger.modules:Talker", "settings": settings}
    if has_station:
        station = "robbie_mp.station:OperatorStation"
        tokens = {f"{role}_token": f"file:{role}.token" for role in ROLES}
        own: dict[str, Any] = {"port": 0, "layouts": {LIVE: LIVE_TILES}, **tokens}
        modules[OPERATOR] = {"class": station, "settings": own}
    return {"modules": modules}


class Pages:
    """A separate process with pages.

    Args:
        kind: one of KINDS.
        address: address of the server.
        visits: role and tab of each page, such as `observer/map`.
    """

    def __init__(self, kind: str, address: str, visits: Sequence[str]):
        self._process = subprocess.Popen(
            [*KINDS[kind], address, *visits],
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        if self._line() != "ready":
            raise RuntimeError(f"the {kind} pages did not open")

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def ask(self, what: str) -> Counts:
        """Send a request: `count` returns how often each page was drawn; `drag` drags and returns rates."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        found: Counts = json.loads(self._line())
        return found

    def cpu_s(self) -> float:
        """Return the processor time of the pages, including the browser's."""
        return sum(cpu_s(pid) for pid in family(self._process.pid))

    def close(self) -> None:
        """Close the pages."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()


def cpu_s(pid: int) -> float:
    """Return the processor time of a process (s), or 0 if it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return times.user + times.system


def measure(session: Session, seconds: float, cells: int, points: int, settle_s: float = SETTLE_S) -> Result:
    """Run the robot for a time, and return the figures of that time."""
    with running(session, cells, points) as robot, ExitStack() as stack:
        pages = slow = None
        if session.tabs:
            visits = [f"{'observer' if at else 'operator'}/{tab}" for at, tab in enumerate(session.tabs)]
            pages = stack.enter_context(closing(Pages(session.kind, address_of(robot), visits)))
        if session.slow_bytes_per_s is not None:
            slow = stack.enter_context(slow_page(robot, session))
        time.sleep(settle_s)
        assert robot.observer is not None
        before, counts = robot.observer.read(), pages.ask("count") if pages else []
        pages_s = pages.cpu_s() if pages else 0.0
        if slow is not None:
            slow.bytes_per_s = session.slow_bytes_per_s or 0.0
        memory = watch(robot, seconds)
        now = robot.observer.read()
        result: Result = {"session": session.name, "kind": session.kind if pages else "", "memory": memory}
        result |= figures(before, now, session.has_station)
        if pages:
            took_s = (now.at_ns - before.at_ns) / 1e9
            result["pages"] = drawn(session.tabs, counts, pages.ask("count"), took_s)
            result["pages_percent"] = 100 * (pages.cpu_s() - pages_s) / took_s
        if pages and session.is_dragged:
            result["dragged"] = pages.ask("drag")
        return result


@contextmanager
def running(session: Session, cells: int, points: int) -> Iterator[Robot]:
    """Run the robot in a temporary folder."""
    with work_folder() as (_, folder):
        (folder / "profiles").mkdir()
        text = yaml.safe_dump(profile(session.has_station, cells, points), sort_keys=False)
        (folder / "profiles" / "load.yaml").write_text(text)
        for role in ROLES:
            (folder / f"{role}.token").touch(mode=0o600)
            (folder / f"{role}.token").write_text(token_of(role))
        robot = Robot(folder, folder, "load")
        try:
            robot.wait_until_running()
            yield robot
            robot.stop()
        finally:
            robot.close()


@contextmanager
def slow_page(robot: Robot, session: Session) -> Iterator[NarrowLink]:
    """Open an additional page, and yield its link, whose rate you can limit."""
    port = int(address_of(robot).rstrip("/").rpartition(":")[2])
    with narrow_link(port) as link:
        slow = Pages(session.kind, f"http://127.0.0.1:{link.port}/", ["observer/view"])
        try:
            yield link
        finally:
            link.bytes_per_s = float("inf")
            slow.close()


def address_of(robot: Robot) -> str:
    """Return the page's address."""
    found: list[str] = []

    def is_there() -> bool:
        found[:] = re.findall(r"http://\S+/", robot.figures()[OPERATOR].status)
        return bool(found)

    robot.wait_for(is_there, "the operator station reports no address")
    return found[0]


def watch(robot: Robot, seconds: float) -> list[dict[str, float]]:
    """Wait. Meanwhile, sample the station's private memory (MB) and its connections once a second."""
    until_s = time.monotonic() + seconds
    samples = []
    while (left_s := until_s - time.monotonic()) > 0:
        time.sleep(min(left_s, SAMPLE_S))
        station = robot.figures().get(OPERATOR)
        if station is not None and station.pid:
            connections = psutil.Process(station.pid).net_connections("tcp")
            established = sum(one.status == psutil.CONN_ESTABLISHED for one in connections)
            own_mb = (station.rss_bytes - station.shared_bytes) / 1e6
            samples.append({"own_mb": own_mb, "connections": established})
    return samples


def figures(before: RunReading, now: RunReading, has_station: bool) -> Result:
    """Return the figures of the robot and its station between two readings."""
    rates = rates_between(before, now)
    listeners = [f"listener{number}" for number in range(PAIRS)]
    result: Result = {
        "small": latency_of(before, now, listeners),
        "image": latency_of(before, now, ["viewer"]),
        "core_percent": rates.modules["core"].cpu_percent,
        "machine_percent": sum(rates.cpu_percent) / len(rates.cpu_percent),
        "refused": sum(module.refused for module in now.modules),
    }
    if has_station:
        result["station_percent"] = rates.modules[OPERATOR].cpu_percent
    return result


def drawn(tabs: Sequence[str], before: Counts, now: Counts, took_s: float) -> list[dict[str, Any]]:
    """Return how often per second each page was drawn."""
    found = []
    for tab, earlier, later in zip(tabs, before, now, strict=True):
        rates = {name: (later[name] - earlier[name]) / took_s for name in COUNTED.get(tab, (tab,))}
        found.append({"tab": tab} | rates)
    return found


def updates_hz(result: Result, tab: str) -> list[float]:
    """Return how often per second each page with a given tab was drawn."""
    return [page[tab] for page in result.get("pages", []) if page["tab"] in (tab, TILES)]


def own_mb(result: Result) -> tuple[float, float] | None:
    """Return the station's private memory: the medians of the first and of the last third of the time."""
    samples = [sample["own_mb"] for sample in result["memory"]]
    third = len(samples) // 3
    return (median(samples[:third]), median(samples[-third:])) if third else None
