"""The standard comparison: one table beside every peer that is installed, in 20 minutes."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tools.bench import load, messages, restart
from tools.bench.contender import Contender
from tools.bench.machine import QuietMachine
from tools.bench.options import Options, peer, peers
from tools.bench.rounds import Series, run_work
from tools.bench.work import Work

Result = dict[str, Any]

TEN = 10
KILLS = 10
WINDOW_S = 3.0
SMALL = Work("", Path(), rate_hz=1000.0)
IMAGE = Work("", Path(), rate_hz=messages.IMAGE_HZ, warm_up=5)


@dataclass(frozen=True)
class Traffic:
    """Messages of one size at one rate.

    Attributes:
        title: what is sent to whom.
        work: the work.
        count: number of messages; a p99.9 needs 10,000.
        floor: the peer that is the lower bound; '': there is none.
        rounds: how often each contender is measured, each time with new processes.
    """

    title: str
    work: Work
    count: int
    floor: str = ""
    rounds: int = 1


CASES = (
    Traffic("64 bytes, 1 kHz, 1 subscriber", SMALL, 10_000, "floor", rounds=3),
    Traffic("64 bytes, 30 Hz, 1 subscriber", replace(SMALL, rate_hz=30.0, warm_up=5), 240, "floor"),
    Traffic("64 bytes, 1 kHz, 8 subscribers", replace(SMALL, subscribers=messages.FANOUT), 2000),
    Traffic("1 kB, 1 kHz, 1 subscriber", replace(SMALL, size_bytes=1000), 2000, "memcpy"),
    Traffic("64 kB, 1 kHz, 1 subscriber", replace(SMALL, size_bytes=64_000), 2000, "memcpy"),
    Traffic("1 MB, 30 Hz, 1 subscriber", replace(IMAGE, size_bytes=messages.MEGABYTE), 90, "memcpy"),
    Traffic("6.2 MB, 30 Hz, 1 subscriber", replace(IMAGE, size_bytes=messages.IMAGE_BYTES), 90, "memcpy"),
    Traffic(
        "1 MB, 30 Hz, 8 subscribers",
        replace(IMAGE, size_bytes=messages.MEGABYTE, subscribers=messages.FANOUT),
        60,
    ),
)


def standard(options: Options) -> list[Result]:
    """Measure all rows of the table while the machine is quiet."""
    quiet = replace(options, watched=QuietMachine())
    once = replace(quiet, rounds=1)
    counted = replace(once, seconds=options.seconds or WINDOW_S, modules=options.modules or TEN)
    return [
        *(_latency(quiet, case) for case in CASES),
        *messages.throughput(once),
        *load.loaded(replace(counted, modules=0)),
        *load.idle(counted),
        *restart.restart(replace(once, count=options.count or KILLS)),
    ]


def _latency(options: Options, case: Traffic) -> Result:
    """Measure one case. Arrays are filled in place by those who can."""
    work = replace(case.work, count=options.count or (case.count // 20 if options.quick else case.count))
    floor = [Series(peer(case.floor))] if case.floor else []
    contenders: list[Contender] = [*options.robbies(), *peers()]
    series = options.chosen([*floor, *(_at_its_best(one, work) for one in contenders)])
    rows = run_work(series, work, options.times(case.rounds, 1), options.budget_s, options.watched)
    return {
        "benchmark": "latency",
        "title": case.title,
        "kind": "latency",
        "reference": "robbie",
        "contenders": rows,
    }


def _at_its_best(contender: Contender, work: Work) -> Series:
    return Series(contender, {"in_place": True} if contender.can_fill_in_place and work.has_array else {})
