"""Measures what one stopped module costs the others: their latency with and without the stop."""

import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from tools.kill_campaign.profile import roles, write_workspace
from tools.kill_campaign.verdict import read_records
from tools.robot import Robot

VICTIMS = ("sink_all", "holder", "sink_large")
STOP_S = 8.0
"""Less than the time after which the supervisor restarts a stopped module as hung."""
SETTLE_S = 3.0
"""Time after a stop for the modules to handle their queued messages."""
ALLOWED_RATIO = 1.5

Span = tuple[int, int]
"""From and to, ns of the monotonic clock."""


def measure_stop_latency(folder: Path, rounds: int, stop_s: float = STOP_S) -> dict[str, Any]:
    """Stop one module after another for 8 s, and compare the others' latency with as long a time before.

    Latency is the time from publishing to entering the handler. The report gives the 99th percentiles over
    all messages of all other subscribers. More than 1.5 times the latency during the stops is a violation.
    """
    settings = roles(overloaded=False)
    write_workspace(folder / "workspace", settings, {})
    robot = Robot(folder, folder / "workspace", "campaign")
    spans: list[tuple[str, Span, Span]] = []
    try:
        robot.wait_until_running()
        for turn in range(rounds):
            time.sleep(SETTLE_S)
            spans.append(_stop_one(robot, VICTIMS[turn % len(VICTIMS)], stop_s))
        robot.stop()
    finally:
        robot.close()
    records = read_records(robot.output, list(settings))
    undisturbed, stopped = [], []
    for victim, calm, stop in spans:
        for name, record in records.items():
            if name != victim and record.entered_ns:
                at, latency_ns = np.array(record.entered_ns), np.array(record.latency_ns)
                undisturbed.append(latency_ns[(at >= calm[0]) & (at < calm[1])])
                stopped.append(latency_ns[(at >= stop[0]) & (at < stop[1])])
    before, during = _figures(np.concatenate(undisturbed)), _figures(np.concatenate(stopped))
    ratio = during["p99_ms"] / before["p99_ms"]
    return {
        "stopped_in_turn": [victim for victim, _, _ in spans],
        "undisturbed": before,
        "during_stops": during,
        "p99_ratio": round(ratio, 3),
        "violations": [f"p99 is {ratio:.2f} times as long"] if ratio > ALLOWED_RATIO else [],
    }


def _stop_one(robot: Robot, victim: str, stop_s: float) -> tuple[str, Span, Span]:
    start = time.monotonic_ns()
    time.sleep(stop_s)
    pid, middle = robot.figures()[victim].pid, time.monotonic_ns()
    robot.send(pid, signal.SIGSTOP)
    time.sleep(stop_s)
    end = time.monotonic_ns()
    robot.send(pid, signal.SIGCONT)
    return victim, (start, middle), (middle, end)


def _figures(latency_ns: np.ndarray) -> dict[str, float]:
    p50, p99 = np.percentile(latency_ns, [50, 99]) / 1e6
    return {"messages": len(latency_ns), "p50_ms": round(float(p50), 3), "p99_ms": round(float(p99), 3)}
