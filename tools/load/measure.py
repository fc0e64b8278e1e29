"""Runs the robot once, with or without a recorder, and returns the figures."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from robbie_mp.bus.observe.figures import RunReading
from robbie_mp.bus.observe.rates import rates_between
from robbie_mp.bus.transport.histogram import Histogram
from robbie_mp.logs.recording.info import last_counts
from robbie_mp.logs.recording.reader import open_log
from tools.bench.contender import work_folder
from tools.robot import Robot, running

Result = dict[str, Any]

MODULES = "tools.load.modules"
RECORDER = "recorder"
WITHOUT, TAKER, LOGGER = "without", "taker", "logger"
CLASSES = {TAKER: f"{MODULES}:Taker", LOGGER: "robbie_mp.logs.message_logger:MessageLogger"}
PAIRS = 9
SMALL_HZ = 2000.0
SETTLE_S = 3.0
MEGABYTE = 1e6


def profile(recorder: str) -> dict[str, Any]:
    """Return a profile of twenty modules and possibly a recorder, which is the first and so stops last."""
    modules: dict[str, Any] = {}
    if recorder in CLASSES:
        queue = {"messages": 20_000, "bytes": 1 << 27}
        modules[RECORDER] = {"class": CLASSES[recorder], "queue": queue, "stop_grace_s": 30.0}
    modules["viewer"] = {"class": f"{MODULES}:Viewer"}
    for number in range(PAIRS):
        modules[f"listener{number}"] = {"class": f"{MODULES}:Listener", "settings": {"number": number}}
    for number in range(PAIRS):
        settings_of = {"number": number, "rate_hz": SMALL_HZ / PAIRS}
        modules[f"talker{number}"] = {"class": f"{MODULES}:Talker", "settings": settings_of}
    modules["camera"] = {"class": f"{MODULES}:ImageSource"}
    return {"modules": modules}


def measure(recorder: str, seconds: float, settle_s: float = SETTLE_S) -> Result:
    """Run the robot for a time. Return the figures of that time and those of the whole log."""
    with work_folder() as (_, folder), running(folder, profile(recorder)) as robot:
        robot.wait_until_running()
        time.sleep(settle_s)
        assert robot.observer is not None
        before, written = robot.observer.read(), _written_bytes(robot)
        time.sleep(seconds)
        now, written_now = robot.observer.read(), _written_bytes(robot)
        summary = robot.stop()
        result: Result = {"recorder": recorder} | _figures(before, now)
        if recorder in CLASSES:
            took_s = (now.at_ns - before.at_ns) / 1e9
            result["disk_mb_per_s"] = (written_now - written) / MEGABYTE / took_s
            (counted,) = [module for module in summary["modules"] if module["name"] == RECORDER]
            result |= {"handled": counted["handled"], "lost": counted["lost"]}
            result["dropped"] = counted["dropped"] - counted["left"]
        if recorder == LOGGER:
            result |= _log_figures(robot.output)
        return result


def _written_bytes(robot: Robot) -> int:
    """Return how much the recorder's process has written to the disk so far."""
    recorder = robot.figures().get(RECORDER)
    return psutil.Process(recorder.pid).io_counters().write_bytes if recorder is not None else 0


def _figures(before: RunReading, now: RunReading) -> Result:
    rates = rates_between(before, now)
    result: Result = {
        "core_percent": rates.modules["core"].cpu_percent,
        "machine_percent": sum(rates.cpu_percent) / len(rates.cpu_percent),
        "small": latency_of(before, now, [f"listener{number}" for number in range(PAIRS)]),
        "image": latency_of(before, now, ["viewer"]),
    }
    if now.module(RECORDER) is not None:
        result["recorder_percent"] = rates.modules[RECORDER].cpu_percent
    return result


def latency_of(before: RunReading, now: RunReading, names: Sequence[str]) -> Result:
    """Return the latency of some modules' messages, taken together."""
    earlier, later = histogram_of(before, names), histogram_of(now, names)
    distribution = later.distribution(earlier)
    assert distribution.p50_s is not None
    assert distribution.p99_s is not None
    p50_us, p99_us = distribution.p50_s * 1e6, distribution.p99_s * 1e6
    return {"count": distribution.count, "p50_us": p50_us, "p99_us": p99_us}


def histogram_of(reading: RunReading, names: Sequence[str]) -> Histogram:
    """Return the latencies of some modules' messages so far, taken together."""
    modules = [reading.module(name) for name in names]
    latencies = [module.work.latency for module in modules if module is not None and module.work is not None]
    counts = np.sum([latency.counts for latency in latencies], axis=0)
    return Histogram(
        sum(latency.sum_ns for latency in latencies), max(latency.max_ns for latency in latencies), counts
    )


def _log_figures(output: Path) -> Result:
    """Return the figures in the log's summary, and those of its contents."""
    files = sorted(output.rglob("*.mcap"))
    with open_log(files[0] if len(files) == 1 else files[0].parent) as log:
        counts = [count for part in log.parts for count in last_counts(part).values()]
        return {
            "log_mb": sum(file.stat().st_size for file in files) / MEGABYTE,
            "log_messages": sum(log.counts.values()),
            "log_recorded": sum(count.recorded for count in counts),
            "log_dropped": sum(count.dropped for count in counts),
            "log_complete": log.is_complete,
        }
