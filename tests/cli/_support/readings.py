"""Invented readings of runs."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from robbie_mp.bus.observe import (
    ChannelFigures,
    CoreFigures,
    ModuleFigures,
    RunReading,
    SubscriptionFigures,
    WorkHistograms,
    rates_between,
)
from robbie_mp.bus.observe.figures import MachineReading
from robbie_mp.bus.transport.histogram import Histogram
from robbie_mp.bus.transport.layout import HISTOGRAM_BUCKETS
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli.top_program.feed import Snapshot, Sparklines, Watching
from robbie_mp.run.run_directory import KnownRun, RunRecord

SECOND_NS = 10**9
SCAN = ("sensor_msgs/msg/LaserScan", 1, "front")
RUNNING, BACKOFF, FAILED = 2, 3, 4


def histogram(count: int) -> Histogram:
    counts = np.zeros(HISTOGRAM_BUCKETS, np.int64)
    counts[100] = count
    return Histogram(count * 10**6, 10**6, counts)


def module(name: str, **known: object) -> ModuleFigures:
    """A module with default figures, except those given."""
    empty: dict[object, object] = {str: "", int: 0, float: 0.0}
    values = {field.name: empty.get(field.type, ()) for field in dataclasses.fields(ModuleFigures)}
    work = WorkHistograms(*(histogram(5) for _ in range(4)))
    values |= {"name": name, "state": RUNNING, "pid": 1, "incarnation": 1, "work": work, "queue_messages": 10}
    return ModuleFigures(**(values | known))  # type: ignore[arg-type]


def reading(at_s: float, *modules: ModuleFigures, heartbeat_s: float | None = None) -> RunReading:
    at_ns = round(at_s * SECOND_NS)
    return RunReading(
        at_ns=at_ns,
        wall_time_s=at_s,
        core=CoreFigures(
            routed=round(100 * at_s),
            wakeups=0,
            faults=0,
            heartbeat_ns=at_ns if heartbeat_s is None else round(heartbeat_s * SECOND_NS),
            handles=7,
            handles_limit=100,
            references=7,
            references_limit=100,
        ),
        modules=(module("supervisor"), *modules, module("core", work=None, queue_messages=0)),
        channels=(
            ChannelFigures(
                **ChannelName(*SCAN)._asdict(),
                messages=round(40 * at_s),
                bytes=round(4000 * at_s),
                last_ns=at_ns - SECOND_NS // 4,
                intervals_squared=round(40 * at_s * (20_000**2 + 30_000**2) / 2),  # 20 and 30 ms in turn
            ),
            ChannelFigures(1, 9, 5, type_name="nav_msgs/msg/OccupancyGrid", version=1, topic=""),
        ),
        segments=(),
        machine=MachineReading((at_s / 2,), (1.0, 2.0, 3.0), 50, 100, 10, 100),
    )


def laser(at_s: float, **known: object) -> ModuleFigures:
    return module("laser", published=round(40 * at_s), cpu_s=0.1 * at_s, publishes=(SCAN,), **known)


def mapping(at_s: float, **known: object) -> ModuleFigures:
    books = SubscriptionFigures(40, 30, 0, 5, 0, SCAN[0], SCAN[2], "ALWAYS_DELIVER", left=2, version=1)
    values: dict[str, object] = {
        "handled": round(30 * at_s),
        "cpu_s": 0.5 * at_s,
        "subscriptions": (books,),
        "status": "draws [a] map",
        "states": "EXPLORE",
    }
    return module("mapping", **(values | known))


def run(run_id: str = "0a1b2c3d", output: Path = Path("/nowhere")) -> KnownRun:
    record = RunRecord(run_id, "demo", 1, 1, "2026-11-21T00:00:00", "python", str(output), "/robot", True)
    return KnownRun(run_id, Path("/nowhere") / run_id, True, record)


def both(at_s: float) -> tuple[ModuleFigures, ...]:
    return laser(at_s), mapping(at_s)


class PlayedFeed:
    """Plays a run whose time passes by a second with each look.

    Attributes:
        watching: what there is to see.
        modules: makes the modules of a moment.
    """

    def __init__(self, output: Path = Path("/nowhere")) -> None:
        self.history = Sparklines()
        self.watching = Watching.RUN
        self.runs: tuple[KnownRun, ...] = (run(output=output),)
        self.modules: Callable[[float], tuple[ModuleFigures, ...]] = both
        self.heartbeat_s: float | None = None
        self.chosen = 0
        self._now_s = 100.0

    def poll(self) -> Snapshot:
        if self.watching in (Watching.NOTHING, Watching.SEVERAL):
            return Snapshot(self.watching, self.runs)
        before, self._now_s = self._now_s, self._now_s + 1
        readings = [
            reading(at_s, *self.modules(at_s), heartbeat_s=self.heartbeat_s) for at_s in (before, self._now_s)
        ]
        rates = rates_between(*readings)
        self.history.add(rates)
        return Snapshot(self.watching, self.runs, self.runs[0], readings[1], rates)

    def choose_next(self) -> None:
        self.chosen += 1
