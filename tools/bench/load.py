"""The benchmarks of processor time: `idle` and `scale`."""

import contextlib
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil

from tools.bench import record
from tools.bench.contender import PeerContender, Trouble, wait_for_end, work_folder
from tools.bench.goals import ALONE
from tools.bench.options import Options, peers
from tools.bench.processes import family, measure_cpu_ns, process_ns
from tools.bench.robbie import RobbieContender
from tools.bench.rounds import Series, run_rounds
from tools.bench.work import Work
from tools.robot import Robot

Result = dict[str, Any]

IDLE_MODULES = 20
MOST_MODULES = 64
SETTLE_S = 1.0
MARGIN_S = 2.0
"""How much longer a peer's publisher is silent than the measurement takes."""
SPARE = "spare"
"""Process name of a spare interpreter that has finished its imports."""
CONNECT_LIMIT_S = 30.0
POLL_S = 0.05
SCALE_HZ = 1000.0
LOAD_HZ = 1500.0


@dataclass(frozen=True)
class Bus:
    """The modules on the bus in one row of `scale`.

    Attributes:
        title: name of the row in the table.
        pairs: number of pairs of a publisher and its subscriber. Each pair has a separate topic, and all
            pairs have the same rate.
        idle: number of subscribers to a topic on which no message is published.
        rate_hz: rate of all messages together.
    """

    title: str
    pairs: int
    idle: int
    rate_hz: float


def buses(most: int) -> list[Bus]:
    """Return the buses that `scale` measures. The next two are compared to the first.

    Args:
        most: maximum number of modules; even, and at least 4.
    """
    loaded = min(20, most)
    return [
        Bus(ALONE, 2, 0, SCALE_HZ),
        Bus(f"{most} modules, 4 exchange all messages", 2, most - 4, SCALE_HZ),
        Bus(f"{most} modules exchange messages", most // 2, 0, SCALE_HZ),
        Bus(f"{loaded} modules, {LOAD_HZ:,.0f} messages/s", loaded // 2, 0, LOAD_HZ),
    ]


def idle(options: Options) -> list[Result]:
    """Measure the processor time of idle modules, and of the same number of idle subscribers of each peer."""
    window_s = options.window_s(10.0, 2.0)
    count = options.modules or IDLE_MODULES
    series = options.chosen([*map(Series, options.robbies()), *map(Series, peers())])

    def run(one: Series) -> float:
        if isinstance(one.contender, RobbieContender):
            return _idle_robot(one.contender, count, window_s)
        assert isinstance(one.contender, PeerContender)
        return _idle_peer(one.contender, count, window_s)

    run_rounds(series, run, options.times(2, 1), options.budget_s)
    rows = [one.describe() | {"cpu_percent": one.outcomes} for one in series]
    title = f"{count} idle modules, {window_s:g} s: processor time of all processes"
    return [{"benchmark": "idle", "title": title, "kind": "idle", "contenders": rows}]


def scale(options: Options) -> list[Result]:
    """Measure how the cost of a message grows with the number of modules on the bus."""
    window_s = options.window_s(10.0, 2.0)
    most = options.modules or (24 if options.quick else MOST_MODULES)
    series = options.chosen(
        [Series(one, {"bus": bus}, bus.title) for one in options.robbies() for bus in buses(most)]
    )

    def run(one: Series) -> Result:
        assert isinstance(one.contender, RobbieContender)
        return measure_bus(one.contender, one.changes["bus"], window_s)

    run_rounds(series, run, options.times(3, 1), options.budget_s)
    rows = [one.describe() | {"each": one.outcomes} for one in series]
    return [{"benchmark": "scale", "title": "cost of a message", "kind": "scale", "contenders": rows}]


def _idle_robot(contender: RobbieContender, count: int, window_s: float) -> float:
    with work_folder() as (topic, folder):
        work = Work(topic, folder, subscribers=count)
        with contender.robot(folder, subscribers_only(contender.pair(work))) as robot:
            _settle(robot, contender)
            return measure_cpu_ns(family(robot.supervisor.pid), window_s) / 1e7 / window_s


def _settle(robot: Robot, contender: RobbieContender) -> None:
    """Wait until all modules run and the spare interpreter has done its imports."""
    robot.wait_until_running()
    supervisor = psutil.Process(robot.supervisor.pid)
    robot.wait_for(lambda: any(_name(child) == SPARE for child in supervisor.children()), "no spare is warm")
    time.sleep(SETTLE_S + contender.settle_s)


def _name(process: psutil.Process) -> str:
    with contextlib.suppress(psutil.Error):
        return process.name()
    return ""


def subscribers_only(modules: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the subscribers among the modules."""
    return {name: module for name, module in modules.items() if not name.startswith("publisher")}


def _idle_peer(contender: PeerContender, count: int, window_s: float) -> float:
    with work_folder() as (topic, folder):
        pause_s = SETTLE_S + window_s + MARGIN_S
        work = Work(topic, folder, count=0, subscribers=count, warm_up=1, pause_s=pause_s)
        try:
            with contender.started(work) as processes:
                _wait_for_pause(work, processes)
                pids = family(*(process.pid for process in processes))
                percent = measure_cpu_ns(pids, window_s) / 1e7 / window_s
                wait_for_end(processes, CONNECT_LIMIT_S)
                return percent
        finally:
            contender.peer.clean(work)


def _wait_for_pause(work: Work, processes: list[subprocess.Popen[bytes]]) -> None:
    """Wait until all subscribers have received the warm-up. From then on, the publisher is silent."""
    deadline_s = time.monotonic() + CONNECT_LIMIT_S
    while not (record.publisher_file(work).exists() and record.map_publisher(work)[record.ENDED_NS]):
        ended = [process.returncode for process in processes if process.poll() is not None]
        if any(ended) or time.monotonic() > deadline_s:
            raise Trouble(f"the {work.subscribers} subscribers did not connect")
        time.sleep(POLL_S)
    time.sleep(SETTLE_S)


def measure_bus(contender: RobbieContender, bus: Bus, window_s: float) -> Result:
    """Run a robot; return the processor time of core and robot, per message and in percent of a processor."""
    with work_folder() as (topic, folder):
        modules: dict[str, dict[str, Any]] = {}
        works = []
        for index in range(bus.pairs):
            (folder / f"pair-{index}").mkdir()
            rate_hz = bus.rate_hz / bus.pairs
            count = round(rate_hz * (window_s + 120))
            works.append(Work(f"{topic}-{index}", folder / f"pair-{index}", count=count, rate_hz=rate_hz))
            modules |= contender.pair(works[-1], f"-{index}")
        bystanders = Work(f"{topic}-silence", folder, count=0, subscribers=bus.idle)
        modules |= subscribers_only(contender.pair(bystanders, "-idle")) if bus.idle else {}
        with contender.robot(folder, modules) as robot:
            _settle(robot, contender)
            result = _sample(robot, window_s)
        latencies_us = np.concatenate([_latencies_us(work) for work in works])
        p50_us, p99_us = np.quantile(latencies_us, (0.5, 0.99))
        return result | {"p50_us": float(p50_us), "p99_us": float(p99_us)}


def _sample(robot: Robot, window_s: float) -> Result:
    assert robot.observer is not None
    pids, core = family(robot.supervisor.pid), robot.figures()["core"].pid
    began_s, routed, core_began_ns = time.monotonic(), robot.observer.routed, process_ns(core)
    all_ns = measure_cpu_ns(pids, window_s)
    core_ns, messages = process_ns(core) - core_began_ns, robot.observer.routed - routed
    took_s = time.monotonic() - began_s
    return {
        "messages_per_s": messages / took_s,
        "core_us_per_message": core_ns / 1e3 / max(1, messages),
        "robot_us_per_message": all_ns / 1e3 / max(1, messages),
        "core_percent": core_ns / 1e7 / took_s,
        "robot_percent": all_ns / 1e7 / took_s,
    }


def _latencies_us(work: Work) -> Any:
    words = np.fromfile(record.subscriber_file(work, 0), np.int64)[record.HEADER :]
    return words[words > 0] / 1e3
