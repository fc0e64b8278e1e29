"""Measures how links scale with the number of robots at one router of Zenoh, on loopback.

    python -m tools.link.scale --robots 10 25 50 100 --seconds 5
    python -m tools.link.scale --shape mesh --robots 5 10 20

`star`: every robot exchanges messages with one base station. `mesh`: every robot with every other one. Each
sends its state ten times a second. The links are those of the module, with a session of Zenoh each, but four
processes share them, and no robots run behind them.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from robbie_mp.base.linux.proc import read_usage
from tools.bench.machine import describe_machine
from tools.bench.peers.zenoh_tcp import free_port
from tools.link.scale.robots import Plan, Result

PROCESSES = 4
STATE_HZ = 10.0
SETTLE_S, SETTLE_EACH_S = 5.0, 0.1
"""Time from the start until the measurement, and more for each robot: the links find each other meanwhile."""
LIMIT_S = 120.0


@dataclass
class Figures:
    """What was measured with a number of robots.

    Attributes:
        up: ratio of the links that are up.
        received: ratio of the states that have arrived.
        p50_ms, p99_ms: from sending to receiving.
        packets_per_s: that the router has delivered.
        router_percent: processor time of the router.
        robot_percent: processor time of one robot's link, the mean.
        base_percent: processor time of the base station's link; 0 in a mesh.
    """

    shape: str
    robots: int
    up: float
    received: float
    p50_ms: float
    p99_ms: float
    packets_per_s: float
    router_percent: float
    robot_percent: float
    base_percent: float


def measure(shape: str, robots: int, seconds: float, settle_s: float | None = None) -> Figures:
    """Measure with a number of robots.

    Args:
        shape: "star" or "mesh".
        robots: how many, without the base station.
        seconds: length of the measurement.
        settle_s: time before it; None: as long as it takes this many robots to find each other.
    """
    address = f"tcp/127.0.0.1:{free_port()}"
    settle_s = SETTLE_S + SETTLE_EACH_S * robots if settle_s is None else settle_s
    begin_s = time.monotonic() + settle_s
    end_s = begin_s + seconds
    names = [f"robot{number}" for number in range(robots)]
    groups = [names[index::PROCESSES] for index in range(min(PROCESSES, robots))]
    is_star = shape == "star"
    others, partners = ("base", 1) if is_star else ("robot*", robots - 1)
    plans = [Plan(address, group, others, partners, STATE_HZ, begin_s, end_s) for group in groups]
    if is_star:
        plans.append(Plan(address, ["base"], "robot*", robots, STATE_HZ, begin_s, end_s))
    with ExitStack() as started:
        router = subprocess.Popen([sys.executable, "-m", "tools.link.campaign.router", address])
        started.callback(_end, router)
        processes = [_start(plan, started) for plan in plans]
        time.sleep(max(0.0, begin_s - time.monotonic()))
        before_s = read_usage(router.pid).cpu_s
        time.sleep(max(0.0, end_s - time.monotonic()))
        router_s = read_usage(router.pid).cpu_s - before_s
        results = [_result(process) for process in processes]
    latencies = [one for result in results for one in result.latencies_ms or ()]
    p50, p99 = np.percentile(latencies or [np.nan], [50, 99])
    links = 2 * robots if is_star else robots * partners
    robots_s = sum(one.cpu_s for one in results[: len(groups)])
    return Figures(
        shape,
        robots,
        up=sum(one.up for one in results) / links,
        received=len(latencies) / max(1, sum(one.sent for one in results)),
        p50_ms=float(p50),
        p99_ms=float(p99),
        packets_per_s=sum(one.packets for one in results) / seconds,
        router_percent=100 * router_s / seconds,
        robot_percent=100 * robots_s / seconds / robots,
        base_percent=100 * results[-1].cpu_s / seconds if is_star else 0.0,
    )


def _start(plan: Plan, started: ExitStack) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "tools.link.scale.robots", json.dumps(asdict(plan))]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    started.callback(_end, process)
    return process


def _result(process: "subprocess.Popen[str]") -> Result:
    said, _ = process.communicate(timeout=LIMIT_S)
    if process.returncode:
        raise RuntimeError(f"robots ended with {process.returncode}")
    return Result(**json.loads(said))


def _end(process: "subprocess.Popen[str] | subprocess.Popen[bytes]") -> None:
    process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def row(one: Figures) -> str:
    """Return a row of the table."""
    cells = (
        one.shape,
        f"{one.robots}",
        f"{one.up:.0%}",
        f"{one.received:.1%}",
        f"{one.p50_ms:.1f}, {one.p99_ms:.1f}",
        f"{one.packets_per_s:.0f}",
        f"{one.router_percent:.0f} %",
        f"{one.robot_percent:.1f} %",
        f"{one.base_percent:.0f} %",
    )
    return f"| {' | '.join(cells)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.link.scale", description=__doc__)
    parser.add_argument("--shape", choices=("star", "mesh"), default="star", help="who exchanges messages")
    parser.add_argument("--robots", type=int, nargs="+", default=[10, 25, 50, 100], help="how many")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each measurement (5)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(arguments)
    print("| shape | robots | links up | states received | p50, p99 ms | packets/s | router | robot | base |")
    print("|---" * 9 + "|")
    found = []
    for number in options.robots:
        found.append(measure(options.shape, number, options.seconds))
        print(row(found[-1]), flush=True)
    if options.json:
        report = {"machine": describe_machine(), "figures": [asdict(one) for one in found]}
        options.json.write_text(json.dumps(report, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
