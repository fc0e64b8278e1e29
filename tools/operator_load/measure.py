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

from robbie_mp.observe.figures import RunReading
from robbie_mp.observe.rates import rates_between
from tools.bench.contender import work_folder
from tools.bench.cpu import family
from tools.kill_campaign.robot import REPOSITORY, Robot
from tools.logger_load.measure import latency_of
from tools.operator_load import ROLES, token_of
from tools.operator_load.narrow_link import NarrowLink, narrow_link

Result = dict[str, Any]
Counts = list[dict[str, float]]

MODULES = "tools.operator_load.modules"
OPERATOR = "operator"
PAIRS = 5
TALK_HZ = 100.0
SETTLE_S = 5.0
SAMPLE_S = 1.0
KINDS = {
    # Browsers normally run on other machines, so here they get only the processor time that is left.
    "browser": ["nice", "-n", "19", sys.executable, "-m", "tools.operator_load.browser_pages"],
    "light": [sys.executable, "-m", "tools.operator_load.light_pages"],
}


@dataclass(frozen=True)
class Session:
    """What is measured.

    Args:
        name: of the row.
        has_station: whether the operator's page is served.
        kind: of the pages, see KINDS.
        tabs: what each page shows.
        slow_bytes_per_s: of the link of one page more; None: there is none; 0: it carries nothing any more.
        is_dragged: whether a mouse drags and zooms in the pages, when all else has been measured.
    """

    name: str
    has_station: bool = True
    kind: str = "light"
    tabs: tuple[str, ...] = ()
    slow_bytes_per_s: float | None = None
    is_dragged: bool = False


def profile(has_station: bool, cells: int, points: int) -> dict[str, Any]:
    """Describe the robot."""
    modules: dict[str, Any] = {
        "rover": {"class": f"{MODULES}:Rover"},
        "mapping": {"class": f"{MODULES}:MapMaker", "settings": {"cells": cells}},
        "depth": {"class": f"{MODULES}:DepthCamera", "settings": {"points": points}},
        "left": {"class": f"{MODULES}:Camera", "settings": {"place": "left"}},
        "right": {"class": f"{MODULES}:Camera", "settings": {"place": "right"}},
        "viewer": {"class": "tools.logger_load.modules:Viewer"},
    }
    for number in range(PAIRS):
        settings = {"number": number, "rate_hz": TALK_HZ}
        modules[f"listener{number}"] = {
            "class": "tools.logger_load.modules:Listener",
            "settings": {"number": number},
        }
        modules[f"talker{number}"] = {"class": "tools.logger_load.modules:Talker", "settings": settings}
    if has_station:
        station = "robbie_mp.station:OperatorStation"
        tokens = {f"{role}_token": f"file:{role}.token" for role in ROLES}
        modules[OPERATOR] = {"class": station, "settings": {"port": 0, **tokens}}
    return {"modules": modules}


class Pages:
    """Pages in a process of their own.

    Args:
        kind: of KINDS.
        address: of the server.
        visits: role and tab of each, such as `observer/map`.
    """

    def __init__(self, kind: str, address: str, visits: Sequence[str]):
        self._process = subprocess.Popen(
            [*KINDS[kind], address, *visits],
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._line() != "ready":
            raise RuntimeError(f"the {kind} pages did not come up")

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def ask(self, what: str) -> Counts:
        """Ask for a `count`, how often each page has been drawn so far; or have them dragged by `drag`."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        found: Counts = json.loads(self._line())
        return found

    def cpu_s(self) -> float:
        """Return the processor time of these pages and what draws them."""
        return sum(cpu_s(pid) for pid in family(self._process.pid))

    def close(self) -> None:
        """Close them."""
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
    """Return the processor time of a process, s; 0 if it has ended."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return times.user + times.system


def measure(session: Session, seconds: float, cells: int, points: int, settle_s: float = SETTLE_S) -> Result:
    """Run the robot for a while, and return figures of that while."""
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
    """Run the robot in a folder of its own."""
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
    """Have one page more, whose link will be narrow when it has been loaded."""
    port = int(address_of(robot).rstrip("/").rpartition(":")[2])
    with narrow_link(port) as link:
        slow = Pages(session.kind, f"http://127.0.0.1:{link.port}/", ["observer/view"])
        try:
            yield link
        finally:
            link.bytes_per_s = float("inf")
            slow.close()


def address_of(robot: Robot) -> str:
    """Return where the page is."""
    found: list[str] = []

    def is_there() -> bool:
        found[:] = re.findall(r"http://\S+/", robot.figures()[OPERATOR].status)
        return bool(found)

    robot.wait_for(is_there, "the operator station says no address")
    return found[0]


def watch(robot: Robot, seconds: float) -> list[dict[str, float]]:
    """Wait, and meanwhile note the station's own memory (MB) and its connections once a second."""
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
    """Describe robot and station."""
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
    """Say how often each page was drawn in a second."""
    found = []
    for tab, earlier, later in zip(tabs, before, now, strict=True):
        names = [tab, "frames"] if tab == "view" else [tab]
        rates = {name: (later[name] - earlier[name]) / took_s for name in names}
        found.append({"tab": tab} | rates)
    return found


def updates_hz(result: Result, tab: str) -> list[float]:
    """Return how often the pages that show a tab were drawn in a second."""
    return [page[tab] for page in result.get("pages", []) if page["tab"] == tab]


def own_mb(result: Result) -> tuple[float, float] | None:
    """Return the station's own memory at the begin and at the end: medians of a third of the time each."""
    samples = [sample["own_mb"] for sample in result["memory"]]
    third = len(samples) // 3
    return (median(samples[:third]), median(samples[-third:])) if third else None
