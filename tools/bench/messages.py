"""The benchmarks with one publisher: `latency`, `large`, `fanout`, `throughput` and `relay`."""

import os
import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

from tools.bench.contender import Contender
from tools.bench.options import IN_PLACE, Options, peer, peers
from tools.bench.rounds import Series, run_work
from tools.bench.work import PROBE_BYTES, Work

Result = dict[str, Any]

MEGABYTE = 1 << 20
IMAGE_BYTES = 1920 * 1080 * 3
"""6.2 MB."""
IMAGE_HZ = 30.0
FANOUT = 8
REALTIME_PRIORITY = 10


def latency(options: Options) -> list[Result]:
    """Measure a typed message of 64 bytes at 1 kHz; unless quick, also at 30 Hz and at real-time priority."""
    often = Work("", Path(), count=options.messages(3000, 500), rate_hz=1000.0, warm_up=100)
    works = {"1 kHz": often}
    if not options.quick:
        works["30 Hz"] = replace(often, count=max(1, often.count * 30 // 1000), rate_hz=30.0, warm_up=5)
        if may_run_at(REALTIME_PRIORITY):
            works["1 kHz at SCHED_FIFO"] = replace(often, realtime_priority=REALTIME_PRIORITY)
    results = []
    for title, work in works.items():
        measured: list[Contender] = [peer("floor"), *options.robbies(), *peers()]
        series = [Series(one) for one in measured]
        results.append(
            _latencies(options, "latency", f"64 bytes, {title}, 1 subscriber", work, series, (5, 2))
        )
    return results


def relay(options: Options) -> list[Result]:
    """Measure from a node of ROS 2 through the bridge to a module, beside a relay of rclpy to a node."""
    small = Work("", Path(), count=options.messages(10_000, 500), rate_hz=500.0, warm_up=20)
    image = Work("", Path(), IMAGE_BYTES, count=options.messages(100, 15), rate_hz=5.0, warm_up=3)
    results = []
    for title, work in {"64 bytes, 500 Hz": small, "6.2 MB, 5 Hz": image}.items():
        series = [Series(peer("ros2_bridge")), Series(peer("rclpy_relay"))]
        results.append(
            _latencies(options, "relay", title, work, series, (3, 1)) | {"reference": "ros2_bridge"}
        )
    return results


def may_run_at(priority: int) -> bool:
    """Return whether this user may give processes a real-time priority."""
    return os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] >= priority


def large(options: Options) -> list[Result]:
    """Measure messages with large arrays, copied from an existing array or filled in place."""
    sizes = {"6.2 MB": IMAGE_BYTES} if options.quick else {"1 MB": MEGABYTE, "6.2 MB": IMAGE_BYTES}
    results = []
    for title, size_bytes in sizes.items():
        work = _images(options, size_bytes)
        small = Series(options.robbies()[0], {"size_bytes": PROBE_BYTES}, "64 B")
        series = [Series(peer("memcpy")), small, *_with_arrays(options)]
        results.append(
            _latencies(options, "large", f"{title}, {IMAGE_HZ:g} Hz, 1 subscriber", work, series, (5, 2))
        )
    return results


def fanout(options: Options) -> list[Result]:
    """Measure how long 1 MB takes until the last of eight subscribers has it."""
    work = _images(options, MEGABYTE, subscribers=options.modules or FANOUT)
    title = f"1 MB, {IMAGE_HZ:g} Hz, {work.subscribers} subscribers: until the last one has it"
    return [_latencies(options, "fanout", title, work, _with_arrays(options), (5, 1))]


def throughput(options: Options) -> list[Result]:
    """Measure 64-byte messages at the highest rate. Contenders that can avoid losses are set to do so."""
    count = options.messages(200_000, 20_000)
    work = Work("", Path(), count=count, rate_hz=0.0, warm_up=50, lossless=True)
    zeromq = Series(peer("zeromq"), {"lossless": False}, "default high-water marks")
    measured: list[Contender] = [*options.robbies(), *peers()]
    series = options.chosen([*(Series(one) for one in measured), zeromq])
    rows = run_work(series, work, options.times(5, 1), options.budget_s, options.watched)
    title = f"64 bytes flat out, {count:,} messages, 1 subscriber"
    return [{"benchmark": "throughput", "title": title, "kind": "throughput", "contenders": rows}]


def _images(options: Options, size_bytes: int, subscribers: int = 1) -> Work:
    count = options.messages(60, 15)
    return Work("", Path(), size_bytes, count=count, rate_hz=IMAGE_HZ, subscribers=subscribers, warm_up=5)


def _with_arrays(options: Options) -> list[Series]:
    """Return all contenders, and again those that can fill arrays in place."""
    contenders: list[Contender] = [*options.robbies(), *peers()]
    in_place = [Series(one, {"in_place": True}, IN_PLACE) for one in contenders if one.can_fill_in_place]
    return [*in_place, *(Series(one) for one in contenders)]


def _latencies(
    options: Options, benchmark: str, title: str, work: Work, series: list[Series], rounds: tuple[int, int]
) -> Result:
    rows = run_work(options.chosen(series), work, options.times(*rounds), options.budget_s)
    return {
        "benchmark": benchmark,
        "title": title,
        "kind": "latency",
        "reference": "robbie",
        "contenders": rows,
    }
