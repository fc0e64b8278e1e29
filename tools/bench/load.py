"""The benchmarks of processor time: `idle`, with start and memory, and `loaded`."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.bench import record
from tools.bench.contender import Contender, PeerContender, Trouble, wait_for_end, work_folder
from tools.bench.options import Options, peer, peers
from tools.bench.processes import family, measure_cpu_ns, memory_bytes
from tools.bench.robbie import RobbieContender
from tools.bench.rounds import Series, run_rounds
from tools.bench.work import Work
from tools.robot import Robot

Result = dict[str, Any]

IDLE_MODULES = 20
PAIRS = 10
LOAD_HZ = 1500.0
SETTLE_S = 1.0
MARGIN_S = 2.0
"""How much longer an idle publisher of a peer is silent than the measurement takes."""
SPARE_S = 60.0
"""How much longer publishers have messages than the measurement takes."""
CONNECT_LIMIT_S = 30.0
POLL_S = 0.05


def idle(options: Options) -> list[Result]:
    """Measure idle modules, and the same number of idle subscribers of each peer: start, time, and memory."""
    window_s = options.window_s(10.0, 2.0)
    count = options.modules or IDLE_MODULES
    series = options.chosen([*map(Series, options.robbies()), *map(Series, peers())])

    def run(one: Series) -> Idle:
        if isinstance(one.contender, RobbieContender):
            return _idle_robot(one.contender, count, window_s)
        assert isinstance(one.contender, PeerContender)
        return _idle_peer(one.contender, count, window_s)

    run_rounds(series, run, options.times(2, 1), options.budget_s, options.watched)
    rows = [
        one.describe()
        | {
            "start_s": [idle.start_s for idle in one.outcomes],
            "cpu_percent": [idle.cpu_percent for idle in one.outcomes],
            "memory_mib": [idle.memory_mib for idle in one.outcomes],
        }
        for one in series
    ]
    title = f"{count} idle modules, all processes, {window_s:g} s"
    return [{"benchmark": "idle", "title": title, "kind": "idle", "contenders": rows}]


def loaded(options: Options) -> list[Result]:
    """Measure the processor time of 20 modules, and of as many processes of each peer and of the floor."""
    window_s = options.window_s(10.0, 2.0)
    pairs = options.modules // 2 or PAIRS
    contenders: list[Contender] = [peer("floor"), *options.robbies(), *peers()]
    series = options.chosen([Series(one) for one in contenders])

    def run(one: Series) -> float:
        if isinstance(one.contender, RobbieContender):
            return _loaded_robot(one.contender, pairs, window_s)
        assert isinstance(one.contender, PeerContender)
        return _loaded_peer(one.contender, pairs, window_s)

    run_rounds(series, run, options.times(3, 1), options.budget_s, options.watched)
    rows = [
        one.describe()
        | {"us_per_message": one.outcomes, "cpu_percent": [us * LOAD_HZ / 1e4 for us in one.outcomes]}
        for one in series
    ]
    title = f"{pairs} publishers, {pairs} subscribers, {LOAD_HZ:,.0f} messages/s: time of all processes"
    return [{"benchmark": "loaded", "title": title, "kind": "loaded", "contenders": rows}]


@dataclass(frozen=True)
class Idle:
    """What idle processes cost.

    Attributes:
        start_s: time from their start until all run: a module is RUNNING, a peer's subscriber has a message.
        cpu_percent: of one processor, all together.
        memory_mib: all together; what several share counts once.
    """

    start_s: float
    cpu_percent: float
    memory_mib: float

    @classmethod
    def measure(cls, start_s: float, pids: Sequence[int], window_s: float) -> "Idle":
        """Measure them for some time."""
        percent = measure_cpu_ns(pids, window_s) / 1e7 / window_s
        return cls(start_s, percent, memory_bytes(pids) / (1 << 20))


def _idle_robot(contender: RobbieContender, count: int, window_s: float) -> Idle:
    with work_folder() as (topic, folder):
        modules = contender.pair(Work(topic, folder, subscribers=count))
        del modules["publisher"]
        began_s = time.monotonic()
        with contender.robot(folder, modules) as robot:
            robot.wait_until_running()
            start_s = time.monotonic() - began_s
            _settle(robot)
            return Idle.measure(start_s, family(robot.supervisor.pid), window_s)


def _idle_peer(contender: PeerContender, count: int, window_s: float) -> Idle:
    with work_folder() as (topic, folder):
        pause_s = SETTLE_S + window_s + MARGIN_S
        work = Work(topic, folder, count=0, subscribers=count, warm_up=1, pause_s=pause_s)
        began_s = time.monotonic()
        try:
            with contender.started(work) as processes:
                _wait_until(lambda: _has_warmed_up(work), f"the {count} subscribers did not connect")
                start_s = time.monotonic() - began_s - SETTLE_S
                measured = Idle.measure(start_s, family(*(process.pid for process in processes)), window_s)
                wait_for_end(processes, CONNECT_LIMIT_S)
                return measured
        finally:
            contender.peer.clean(work)


def _has_warmed_up(work: Work) -> bool:
    """Return whether all subscribers have received the warm-up. From then on, the publisher is silent."""
    return record.publisher_file(work).exists() and bool(record.map_publisher(work)[record.ENDED_NS])


def _loaded_robot(contender: RobbieContender, pairs: int, window_s: float) -> float:
    """Run pairs of a publisher and a subscriber; return the processor time of a message in µs."""
    with work_folder() as (topic, folder):
        modules: dict[str, dict[str, Any]] = {}
        for index in range(pairs):
            modules |= contender.pair(_pair(topic, folder, index, pairs, window_s), f"-{index}")
        with contender.robot(folder, modules) as robot:
            _settle(robot)
            assert robot.observer is not None
            before = robot.observer.routed
            used_ns = measure_cpu_ns(family(robot.supervisor.pid), window_s)
            return used_ns / 1e3 / max(1, robot.observer.routed - before)


def _loaded_peer(contender: PeerContender, pairs: int, window_s: float) -> float:
    """Do the same with a peer."""
    with contextlib.ExitStack() as stack:
        topic, folder = stack.enter_context(work_folder())
        works, pids = [], []
        for index in range(pairs):
            work = _pair(topic, folder, index, pairs, window_s)
            stack.callback(contender.peer.clean, work)
            processes = stack.enter_context(contender.started(work))
            works.append(work)
            pids += [process.pid for process in processes]
        received = [record.map_subscriber(work, 0) for work in works]
        _wait_until(lambda: all(_measured(received)), "not all subscribers received messages")
        before = sum(_measured(received))
        used_ns = measure_cpu_ns(family(*pids), window_s)
        return used_ns / 1e3 / max(1, sum(_measured(received)) - before)


def _measured(received: Sequence[memoryview]) -> list[int]:
    return [words[record.MEASURED] for words in received]


def _pair(topic: str, folder: Path, index: int, pairs: int, window_s: float) -> Work:
    own, rate_hz = folder / str(index), LOAD_HZ / pairs
    own.mkdir()
    return Work(f"{topic}-{index}", own, count=round(rate_hz * (window_s + SPARE_S)), rate_hz=rate_hz)


def _settle(robot: Robot) -> None:
    """Wait until all modules run and the spare interpreter has done its imports."""
    robot.wait_until_running()
    robot.wait_for_spare()
    time.sleep(SETTLE_S)


def _wait_until(condition: Callable[[], bool], otherwise: str) -> None:
    deadline_s = time.monotonic() + CONNECT_LIMIT_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise Trouble(otherwise)
        time.sleep(POLL_S)
    time.sleep(SETTLE_S)
