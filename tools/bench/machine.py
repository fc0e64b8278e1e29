"""Describes the machine on which figures are measured, and measures only while it is quiet."""

import contextlib
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, TypeVar

import psutil

from tools.bench.contender import Trouble

Measured = TypeVar("Measured")
NOT_COMPARABLE = "not comparable"

LOOK_S = 0.3
OTHERS_LIMIT = 0.10
"""Most of the processors that others may use, while nothing is measured."""
STEAL_LIMIT = 0.02
"""Most of the processors that other virtual machines may take, also while something is measured."""
SPEED_LIMIT = 0.80
"""A processor slower than this part of the fastest one seen is clocked down, or shared."""
SPIN_ROUNDS = 100_000
PATIENCE_S = 3.0
"""How long a measurement waits until the machine is quiet."""
ATTEMPTS = 3
REPEATS_S = 900.0
"""How long after the start disturbed measurements are repeated: on some hosts none succeeds."""


class NotComparable(Trouble):
    """The machine was too busy, so a figure would mean nothing.

    Example scenarios:
      - another program used the processors
      - the host gave the processors of this virtual machine to another one
      - the processor was clocked down
    """

    def __init__(self, why: str):
        super().__init__(f"{NOT_COMPARABLE}: {why}")


def describe_machine() -> dict[str, Any]:
    """Return the processor, kernel, Python version, load and date."""
    return {
        "date": f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / (1 << 30), 1),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load_before": round(os.getloadavg()[0], 2),
    }


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.machine()


@dataclass(frozen=True)
class ProcessorTimes:
    """Time of all processors since boot, in s. Source: /proc/stat in proc(5)."""

    total_s: float
    used_s: float
    stolen_s: float

    @classmethod
    def now(cls) -> "ProcessorTimes":
        """Read them."""
        times = psutil.cpu_times()
        total_s = sum(times) - times.guest - times.guest_nice  # these are parts of user and nice
        return cls(total_s, total_s - times.idle - times.iowait - times.steal, times.steal)

    def shares_since(self, before: "ProcessorTimes") -> tuple[float, float]:
        """Return which part of the processors was used, and which was stolen, since then."""
        total_s = max(self.total_s - before.total_s, 1e-9)
        return (self.used_s - before.used_s) / total_s, (self.stolen_s - before.stolen_s) / total_s


class QuietMachine:
    """Measures only while nobody else uses the processors. Call it with what measures.

    What others do is seen before and after a measurement; what the host does, also meanwhile. A disturbed
    measurement is repeated, at most twice, and not after a quarter of an hour.
    """

    def __init__(self) -> None:
        self._fastest_s = spin_s()
        self._last_repeat_s = time.monotonic() + REPEATS_S

    def __call__(self, measure: Callable[[], Measured]) -> Measured:
        """Wait until the machine is quiet, and measure.

        Raises:
            NotComparable: the machine was busy, before, after, or meanwhile, each time.
        """
        for _ in range(ATTEMPTS - 1):
            if time.monotonic() > self._last_repeat_s:
                break
            with contextlib.suppress(NotComparable):
                return self._measure_once(measure)
        return self._measure_once(measure)

    def _measure_once(self, measure: Callable[[], Measured]) -> Measured:
        deadline_s = time.monotonic() + PATIENCE_S
        while problem := self.disturbance():
            if time.monotonic() > deadline_s:
                raise NotComparable(problem)
        before = ProcessorTimes.now()
        measured = measure()
        _, stolen = ProcessorTimes.now().shares_since(before)
        if stolen > STEAL_LIMIT:
            raise NotComparable(f"other virtual machines took {stolen:.0%} of the processors")
        if problem := self.disturbance():
            raise NotComparable(problem)
        return measured

    def disturbance(self) -> str:
        """Look for 0.3 s what others do; return why a figure would mean nothing, or ''."""
        taken_s = spin_s()
        self._fastest_s = min(self._fastest_s, taken_s)
        before = ProcessorTimes.now()
        time.sleep(LOOK_S)
        used, stolen = ProcessorTimes.now().shares_since(before)
        if used > OTHERS_LIMIT:
            return f"other programs used {used:.0%} of the processors"
        if stolen > STEAL_LIMIT:
            return f"other virtual machines took {stolen:.0%} of the processors"
        if self._fastest_s < SPEED_LIMIT * taken_s:
            return f"the processor ran at {self._fastest_s / taken_s:.0%} of its speed"
        return ""


def spin_s() -> float:
    """Return how long a loop takes, the best of three."""
    return min(_spin_s() for _ in range(3))


def _spin_s() -> float:
    began_s = time.perf_counter()
    for _ in range(SPIN_ROUNDS):
        pass
    return time.perf_counter() - began_s
