"""Runs a robot for a long time with kills, floods and playback, and watches the resources that it holds.

    python -m tools.kill_campaign.soak --minutes M [--keep DIR] [--json]

The robot is that of the kill campaign; it also plays the Intel log in real time and maps it. The soak test
kills and stops modules, except the supervisor, the core and some modules, whose memory it can then watch all
the time. It ends and judges the run as the campaign does.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from robbie_mp.bus.transport.tables import COLUMNS
from tools.kill_campaign.__main__ import as_text
from tools.kill_campaign.attack import CORE
from tools.kill_campaign.campaign import AttackPlan, run_campaign
from tools.robot import REPOSITORY, Robot, RobotTrouble

LOG = REPOSITORY.parent / "shared" / "data" / "intel.clf"
SPARED = frozenset(
    {CORE, "sink_all", "sink_slow", "holder", "relay", "small", "large", "burst", "playback", "mapping"}
)
SAMPLE_S = 10.0
WARM_UP_SHARE = 0.2
FEW_SAMPLES = 5
MEGABYTE = 1 << 20


@dataclass
class Sample:
    """The resources of one process at one time."""

    at_s: float
    pid: int
    resident_bytes: int
    unique_bytes: int
    descriptors: int
    mappings: int


@dataclass
class Watch:
    """Samples the resources of each process of a robot, and checks that counters never decrease.

    Attributes:
        samples: the samples of each process, by its name.
        violations: counters that decreased.
    """

    samples: dict[str, list[Sample]] = field(default_factory=dict)
    violations: list[str] = field(default_factory=list)
    _next_s: float = 0.0
    _before: dict[tuple[str, str], int] = field(default_factory=dict)

    def look(self, robot: Robot) -> None:
        """Take a sample if one is due."""
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + SAMPLE_S
        figures = robot.figures()
        self._sample("supervisor", robot.supervisor.pid)
        for name, module in figures.items():
            if module.pid:
                self._sample(name, module.pid)
            for column in COLUMNS:
                self.note_counter(name, column, module.total(column))
            self.note_counter(name, "restarts", module.restarts)

    def _sample(self, name: str, pid: int) -> None:
        try:
            process = psutil.Process(pid)
            memory = process.memory_full_info()
            mappings = len(process.memory_maps(grouped=False))
            sample = Sample(time.monotonic(), pid, memory.rss, memory.uss, process.num_fds(), mappings)
        except psutil.Error:
            return  # the process was killed meanwhile
        self.samples.setdefault(name, []).append(sample)

    def note_counter(self, name: str, column: str, value: int) -> None:
        """Record a counter, and check that it is not lower than before."""
        before = self._before.get((name, column), 0)
        if value < before:
            self.violations.append(f"{name}: {column} went from {before} back to {value}")
        self._before[name, column] = value

    def report(self) -> dict[str, Any]:
        """Return the resources of each process, and the slopes of those that lived from warm-up to end."""
        return {name: _describe(samples) for name, samples in self.samples.items()}


def _describe(samples: list[Sample]) -> dict[str, Any]:
    began_s, ended_s = samples[0].at_s, samples[-1].at_s
    warm = [sample for sample in samples if sample.at_s >= began_s + WARM_UP_SHARE * (ended_s - began_s)]
    found: dict[str, Any] = {
        "processes_seen": len({sample.pid for sample in samples}),
        "resident_mb_max": round(max(sample.resident_bytes for sample in samples) / MEGABYTE, 1),
        "descriptors_max": max(sample.descriptors for sample in samples),
    }
    if len({sample.pid for sample in warm}) == 1 and len(warm) >= FEW_SAMPLES:
        times_s = [sample.at_s for sample in warm]
        found |= {
            "resident_mb_per_h": _slope_mb_per_h(times_s, [sample.resident_bytes for sample in warm]),
            "unique_mb_per_h": _slope_mb_per_h(times_s, [sample.unique_bytes for sample in warm]),
            "unique_mb_quarters": [
                round(warm[quarter * (len(warm) - 1) // 4].unique_bytes / MEGABYTE, 2) for quarter in range(5)
            ],
            "descriptors_first_last": [warm[0].descriptors, warm[-1].descriptors],
            "mappings_first_last": [warm[0].mappings, warm[-1].mappings],
        }
    return found


def _slope_mb_per_h(times_s: Sequence[float], values: Sequence[int]) -> float:
    """Return the slope of the least-squares line."""
    return round(float(np.polyfit(times_s, values, 1)[0]) * 3600 / MEGABYTE, 3)


def playback_modules(log: Path) -> dict[str, dict[str, Any]]:
    """Return the two modules of the Intel run, which play the log in real time and in a loop."""
    playback = {
        "class": "robbie_robots.modules.devices.carmen_playback:CarmenPlayback",
        "settings": {"file": str(log), "rate": 1.0},
    }
    return {
        "mapping": {"class": "robbie_robots.modules.maps.mapping:Mapping", "stop_grace_s": 30},
        "playback": playback | {"restart": {"policy": "always"}},
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. The exit code is 0 if there is no violation, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.kill_campaign.soak", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (30)")
    parser.add_argument("--seed", type=int, default=1, help="random seed of all choices (1)")
    parser.add_argument("--log", type=Path, default=LOG, help="a CARMEN log (../shared/data/intel.clf)")
    parser.add_argument(
        "--freeze-log", action="store_true", help="freeze the disk of the logs from time to time (as root)"
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="empty folder for journals and logs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    others = playback_modules(options.log) if options.log.exists() else {}
    if not others:
        print(f"soak: {options.log} does not exist, so no log is played and mapped", file=sys.stderr)
    watch = Watch()
    plan = AttackPlan(
        10**9,
        options.seed,
        options.minutes,
        mean_pause_s=2.0,
        spared=SPARED,
        freeze_log=options.freeze_log,
        others=others,
    )
    with tempfile.TemporaryDirectory(prefix="robbie-soak-") as temporary:
        try:
            report = run_campaign(plan, options.keep or Path(temporary), watch.look)
        except RobotTrouble as trouble:
            report = {"violations": [str(trouble)]}
    report["processes"] = watch.report()
    report["violations"] += watch.violations
    print(json.dumps(report, indent=2) if options.json else as_text(report))
    return 1 if report["violations"] else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive the soak test
    sys.exit(main())
