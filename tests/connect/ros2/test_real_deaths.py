"""A node, the bridge, the core and a program's child die in turn, beside a real node; see `make ros`.

With `--exhaustive`, 500 times; `-s` shows the figures.
"""

import math
import os
import random
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests._support.robot import Robot, command_of, kill, wait_until
from tests.connect.ros2._support import among_deaths, fibonacci
from tests.connect.ros2._support.ros_nodes import WHEELS, RosNode, ros_node

pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]
DOMAIN = 216 + os.getpid() % 14
DEATHS, ALL_DEATHS = 8, 500
QUIET_S = 10.0
CORE_REST_S = 11.0
"""After this time the core has its full budget of restarts again."""
LIMIT_S = 10.0
"""How long the node waits for a response or a result: ROS has no error for a server that has died."""
PROFILE = """
modules:
  rabbits: {class: "zoo.fibonacci:Rabbits"}
  answerer: {class: "zoo.among_deaths:Answerer"}
  caller: {class: "zoo.among_deaths:Caller", settings: {journal: caller.txt}}
  camera: {class: "zoo.among_deaths:Camera"}
  beat: {class: "zoo.among_deaths:Beat"}
  neighbour: {class: "zoo.among_deaths:Neighbour", settings: {journal: neighbour.txt}}
  shell:
    program: [sh, -c, "sleep 100000 & wait"]
    restart: {policy: always, max_restarts: 1000}
  ros2:
    class: "robbie_mp.connect.ros2.module:Ros2Bridge"
    settings:
      middleware: dds
      domain: DOMAIN
      parameters: none
      send: {Image camera: /image depth=1}
      accept: {/back: Image back depth=1}
      services: {/ping: "Ping {}"}
      actions: {/fibonacci: Fibonacci}
      calls: {/node/ping: Trigger}
    restart: {policy: always, max_restarts: 1000}
"""


class Killer:
    """A robot, a node beside it, and what has died."""

    def __init__(self, robot: Robot, distribution: str, domain: int, folder: Path, stack: ExitStack):
        self.robot, self.folder = robot, folder
        self._distribution, self._domain, self._stack = distribution, domain, stack
        self.deaths: Counter[str] = Counter()
        self.nodes = 0
        self.dead: dict[str, list[tuple[float, float]]] = defaultdict(list)
        """When each was dead. Until the next process of the core runs, no message can come to anybody."""
        self._core_rests_until_s = 0.0
        self.node = self._start_node()

    def _start_node(self) -> RosNode:
        self.nodes += 1
        node = self._stack.enter_context(ros_node(self._distribution, self._domain, self.folder))
        path = str(self.folder / f"node-{self.nodes}.txt")
        node.run(among_deaths.NODE, path=path, limit_s=LIMIT_S)
        return node

    def kill(self, victim: str) -> None:
        """Kill, and wait until it runs again."""
        self.deaths[victim] += 1
        killed_s = time.monotonic()
        if victim == "node":
            self.node.kill()
            self.node = self._start_node()
        else:
            self._kill_process(victim)
        self.dead[victim].append((killed_s, time.monotonic()))

    def _kill_process(self, victim: str) -> None:
        name = "shell" if victim == "child" else victim
        before = self.robot.top()[name]
        if victim == "child":
            kill(child_of(before["pid"]))
        else:
            kill(before["pid"])
        if victim == "core":
            self._core_rests_until_s = time.monotonic() + CORE_REST_S
        self.robot.until(lambda top: top[name]["pid"] != before["pid"] and top[name]["state"] == "RUNNING")

    def victims(self) -> list[str]:
        """Return what may die now."""
        core = ["core"] if time.monotonic() > self._core_rests_until_s else []
        return ["node", "ros2", "child", *core]


def child_of(module: int) -> int:
    """Return the process that the shell has started, as soon as there is one."""
    found: list[int] = []

    def is_there() -> bool:
        tree = psutil.Process(module).children(recursive=True)
        found[:] = [one.pid for one in tree if command_of(one)[:1] == ["sleep"]]
        return bool(found)

    wait_until(is_there)
    return found[0]


def events(file: Path) -> dict[tuple[str, str], list[str]]:
    """Return what a journal says of each request."""
    found: dict[tuple[str, str], list[str]] = {}
    for line in file.read_text().splitlines():
        kind, number, event = line.split()
        if kind != "image":
            found.setdefault((kind, number), []).append(event)
    return found


def p99_ms(
    file: Path, times: Iterable[tuple[float, float]], but: Iterable[tuple[float, float]] = ()
) -> float:
    """Return the neighbours' latency in some times, but not for what was sent in others."""
    beats = np.loadtxt(file, ndmin=2)
    at_s, late_s = beats.T
    counts = np.zeros(len(beats), bool)
    for begin_s, end_s in times:
        counts |= (at_s >= begin_s) & (at_s < end_s)
    for begin_s, end_s in but:
        counts &= (at_s < begin_s) | (at_s - late_s > end_s)
    return 1e3 * float(np.percentile(late_s[counts], 99)) if counts.any() else math.nan


@pytest.fixture(params=WHEELS)
def killer(
    request: pytest.FixtureRequest, robot: Robot, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Killer]:
    domain = DOMAIN + WHEELS.index(request.param)
    for module in (fibonacci, among_deaths):
        path = Path(module.__file__ or "")
        (robot.folder / "zoo" / path.name).write_text(path.read_text())
    robot.write_profile(PROFILE.replace("DOMAIN", str(domain)))
    robot.start()
    robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    with ExitStack() as stack:
        yield Killer(robot, request.param, domain, tmp_path_factory.mktemp("nodes"), stack)


def test_each_request_gets_one_reply_or_one_error_whichever_process_dies(
    killer: Killer, request: pytest.FixtureRequest
) -> None:
    robot, chance = killer.robot, random.Random(5)
    journal, caller = robot.folder / "neighbour.txt", robot.folder / "caller.txt"
    wait_until(lambda: int(robot.top()["camera"]["status"].partition(" ")[0] or 0) > 3)
    quiet_s = time.monotonic()
    wait_until(lambda: time.monotonic() > quiet_s + QUIET_S)
    began_s = time.monotonic()
    wanted = ALL_DEATHS if request.config.getoption("--exhaustive") else DEATHS
    while killer.deaths.total() < wanted and time.monotonic() < began_s + longest_s():
        killer.kill(chance.choice(killer.victims()))
        until_s = time.monotonic() + chance.expovariate(1.0)
        wait_until(lambda until_s=until_s: time.monotonic() > until_s)  # type: ignore[misc]
    ended_s = time.monotonic()
    killer.node.run(among_deaths.END)
    asked = max(int(number) for _, number in events(caller))
    wait_until(
        lambda: all(len(found) == 2 for (_, one), found in events(caller).items() if int(one) <= asked)
    )

    quiet = p99_ms(journal, [(quiet_s, began_s)])
    busy = p99_ms(journal, [(began_s, ended_s)])
    with_core = p99_ms(journal, [(began_s, ended_s)], killer.dead["core"])
    each = {victim: f"{p99_ms(journal, times):.0f} ms" for victim, times in killer.dead.items() if times}
    came_back, wrong = map(int, robot.top()["camera"]["status"].split())
    counted = Counter(
        (kind, found[-1]) for (kind, number), found in events(caller).items() if int(number) <= asked
    )
    cut_off: Counter[str] = Counter()
    for index in range(1, killer.nodes + 1):
        for (kind, number), found in events(killer.folder / f"node-{index}.txt").items():
            assert found[1:] in (["reply"], ["error"]) or (found == ["sent"] and index < killer.nodes), (
                kind,
                number,
                found,
            )
            counted[kind, found[-1]] += 1
            cut_off[f"{kind} {index}"] += found == ["sent"]
    print(f"\ndeaths: {dict(killer.deaths)} in {ended_s - began_s:.0f} s; requests: {dict(counted)}")
    print(f"images back: {came_back}; p99 of neighbours: {quiet:.2f} ms, then {busy:.2f} ms")
    print(f"p99 while there was a core: {with_core:.2f} ms, {with_core / quiet:.2f} x")
    print(f"p99 while each was dead: {each}")
    # A node has one request of each kind at a time, so its death cuts off no more.
    assert all(count <= 1 for count in cut_off.values())
    assert not wrong
    assert counted["call", "reply"] and counted["ping", "reply"] and counted["goal", "reply"]


def longest_s() -> float:
    """Return the time after which no more is killed: `ROBBIE_DEATHS_S`, in s."""
    return float(os.environ.get("ROBBIE_DEATHS_S", "7000"))
