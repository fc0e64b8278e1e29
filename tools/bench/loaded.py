"""The benchmark `loaded`: the processor time of many processes that exchange messages."""

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.bench import record
from tools.bench.contender import Contender, PeerContender, Trouble, work_folder
from tools.bench.load import CONNECT_LIMIT_S, LOAD_HZ, POLL_S, SETTLE_S, Bus, measure_bus
from tools.bench.options import Options, peer, peers
from tools.bench.processes import family, measure_cpu_ns
from tools.bench.robbie import RobbieContender
from tools.bench.rounds import Series, run_rounds
from tools.bench.work import Work

PAIRS = 10
SPARE_S = 60.0
"""How much longer the publishers of peers have messages than the measurement takes."""


def loaded(options: Options) -> list[dict[str, Any]]:
    """Measure the processor time of 20 modules, and of as many processes of each peer and of the floor."""
    window_s = options.window_s(10.0, 2.0)
    pairs = options.modules // 2 or PAIRS
    contenders: list[Contender] = [peer("floor"), *options.robbies(), *peers()]
    series = options.chosen([Series(one) for one in contenders])

    def run(one: Series) -> float:
        if isinstance(one.contender, RobbieContender):
            bus = Bus("", pairs, 0, LOAD_HZ)
            return float(measure_bus(one.contender, bus, window_s)["robot_us_per_message"])
        assert isinstance(one.contender, PeerContender)
        return measure_pairs(one.contender, pairs, window_s)

    run_rounds(series, run, options.times(3, 1), options.budget_s)
    rows = [
        one.describe()
        | {
            "us_per_message": one.outcomes,
            "cpu_percent": [us * LOAD_HZ / 1e4 for us in one.outcomes],
        }
        for one in series
    ]
    title = f"{pairs} publishers, {pairs} subscribers, {LOAD_HZ:,.0f} messages/s: time of all processes"
    return [{"benchmark": "loaded", "title": title, "kind": "loaded", "contenders": rows}]


def measure_pairs(contender: PeerContender, pairs: int, window_s: float) -> float:
    """Run pairs of a publisher and a subscriber of a peer; return the processor time of a message in µs."""
    rate_hz = LOAD_HZ / pairs
    with contextlib.ExitStack() as stack:
        topic, folder = stack.enter_context(work_folder())
        works, pids = [], []
        for index in range(pairs):
            work = _work(topic, folder / f"pair-{index}", index, rate_hz, window_s)
            stack.callback(contender.peer.clean, work)
            processes = stack.enter_context(contender.started(work))
            works.append(work)
            pids += [process.pid for process in processes]
        received = [record.map_subscriber(work, 0) for work in works]
        _wait_for_messages(received)
        before = sum(words[record.MEASURED] for words in received)
        used_ns = measure_cpu_ns(family(*pids), window_s)
        return used_ns / 1e3 / max(1, sum(words[record.MEASURED] for words in received) - before)


def _work(topic: str, folder: Path, index: int, rate_hz: float, window_s: float) -> Work:
    folder.mkdir()
    return Work(f"{topic}-{index}", folder, count=round(rate_hz * (window_s + SPARE_S)), rate_hz=rate_hz)


def _wait_for_messages(received: Sequence[memoryview]) -> None:
    """Wait until all pairs exchange the measured messages."""
    deadline_s = time.monotonic() + CONNECT_LIMIT_S
    while not all(words[record.MEASURED] for words in received):
        if time.monotonic() > deadline_s:
            raise Trouble("not all subscribers received messages")
        time.sleep(POLL_S)
    time.sleep(SETTLE_S)
