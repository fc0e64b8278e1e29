"""One run under a known load: the figures of `robbie top` and of other sources."""

import csv
import json
import math
import os
import shutil
import signal
import subprocess
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
import pytest

from robbie_mp.bus.observe import RunObserver, RunReading
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.cli.top_program.feed import RunFeed, Watching
from robbie_mp.messages import LaserScan
from tests._support.robot import COMMAND, Robot, wait_until

PAIRS = 9
BURST = 12
PERIOD_S = 0.05
INTERVAL_S = 3.0
QUEUE = 50
SLOW_S = 0.02
KEPT = 3
CLOCK_TICK_S = 1 / os.sysconf("SC_CLK_TCK")
MODULES = [
    *(
        f"talker{number}: {{class: 'zoo.load:Talker', settings: {{burst: {BURST}}}}}"
        for number in range(PAIRS)
    ),
    *(
        f"hearer{number}: {{class: 'zoo.load:Hearer', settings: {{topic: talker{number}}}}}"
        for number in range(PAIRS - 2)
    ),
    f"keeper: {{class: 'zoo.load:Hearer', settings: {{topic: talker7, keep: {KEPT}}}}}",
    f"slow: {{class: 'zoo.load:Hearer', settings: {{topic: talker8, work_s: {SLOW_S}}}, "
    f"queue: {{messages: {QUEUE}}}}}",
    "ticker: {class: 'zoo.load:Ticker'}",
    "profiler: {class: 'robbie_mp.attached.profiler:Profiler', settings: {period_s: 0.5}}",
    "reporter: {class: 'zoo.load:Reporter'}",
    "hanger: {class: 'zoo.load:Hanger', handler_deadline_s: 60, stop_grace_s: 0.2}",
]
HEARERS = [*(f"hearer{number}" for number in range(PAIRS - 2)), "keeper", "slow"]
QUIET_S = 3.0


@dataclass
class Evidence:
    """The readings during the run, and the files that its modules wrote at the end."""

    begun: RunReading
    loaded: dict[str, Any]
    """Output of `top --json` under load, with the figures of psutil before and after it."""
    loaded_until_s: float
    """When that command had ended, Unix time."""
    psutil_before: dict[int, dict[str, Any]]
    psutil_after: dict[int, dict[str, Any]]
    processors: list[list[float]]
    ended: RunReading
    final: dict[str, Any]
    stat_bytes: dict[str, int]
    maps: list[str]
    hung: dict[str, Any]
    while_core_died: list[int] = field(default_factory=list)
    """Number of modules in each reading."""
    calls: dict[str, list[float]] = field(default_factory=dict)
    """System calls of the core and a module for each message: without and with an observer."""
    recorder_exit_code: int | None = None
    recorded: list[dict[str, str]] = field(default_factory=list)
    """Output of `top --csv`, which ran from the load to the end of the run."""
    books: dict[str, dict[str, Any]] = field(default_factory=dict)

    def sent(self, topic: str) -> int:
        """How many scans were published on a topic."""
        return int(self.books[topic]["sent"][-1][1])

    def module(self, name: str, of: str = "final") -> dict[str, Any]:
        figures: dict[str, Any] = getattr(self, of)
        return next(one for one in figures["modules"] if one["name"] == name)


def gathered(robot: Robot) -> Evidence:
    with pytest.MonkeyPatch.context() as patch:
        # In Python, modules can remember each time that they count. C makes the same stores (tests/bus/hot).
        patch.setenv("ROBBIE_PURE_PYTHON", "1")
        process = robot.start()
    robot.until(lambda modules: all(modules[name]["handled"] > 20 for name in HEARERS))
    run_id = next(Path(os.environ["XDG_RUNTIME_DIR"], "robbie").iterdir()).name
    with closing(RunObserver(run_id)) as observer:
        begun = read_between_messages(observer)
        pids = [module.pid for module in begun.modules]
        processors = [busy_s()]
        before = {pid: by_psutil(pid) for pid in pids}
        recorder = recording(robot, run_id)
        loaded = top(robot, run_id, interval_s=INTERVAL_S)
        loaded_until_s = time.time()
        after = {pid: by_psutil(pid) for pid in pids}
        processors.append(busy_s())
        wait_until(lambda: len(times_of_slow(robot)) > 3)
        (robot.output / "enough").touch()
        wait_until(lambda: is_over(observer.read()))
        final = top(robot, run_id, interval_s=0.0)
        stat_bytes = {
            f"robbie-{run_id}/{path.name}": path.stat().st_size
            for path in Path(f"{SHARED_MEMORY}/robbie-{run_id}").iterdir()
        }
        maps = [line for line in Path("/proc/self/maps").read_text().splitlines() if run_id in line]
        ended = observer.read()
        calls = counted_calls(observer, ended)
    (robot.output / "hang").touch()
    wait_until(lambda: robot.top()["hanger"]["busy_s"] > 1.0)
    hung = top(robot, run_id, interval_s=0.0)
    looks = while_core_dies(run_id)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    recorder.communicate(timeout=20)
    found = Evidence(
        begun,
        loaded,
        loaded_until_s,
        before,
        after,
        processors,
        ended,
        final,
        stat_bytes,
        maps,
        hung,
        looks,
        calls,
    )
    found.recorder_exit_code = recorder.returncode
    with (robot.folder / "figures.csv").open(newline="") as file:
        found.recorded = list(csv.DictReader(file))
    for path in robot.output.glob("*.json"):
        found.books[path.stem] = json.loads(path.read_text())
    return found


def top(robot: Robot, run_id: str, interval_s: float) -> dict[str, Any]:
    answer = robot.command("top", "--json", "--interval", str(interval_s), "--run", run_id)
    assert answer.returncode == 0, answer.stderr
    figures: dict[str, Any] = json.loads(answer.stdout)
    return figures


def recording(robot: Robot, run_id: str) -> "subprocess.Popen[bytes]":
    command = [*COMMAND, "top", "--csv", "figures.csv", "--interval", "0.5", "--run", run_id]
    return subprocess.Popen(command, cwd=robot.folder)


def times_of_slow(robot: Robot) -> list[str]:
    """Return the 99th percentiles of the slow module's handler in the recording so far."""
    file = robot.folder / "figures.csv"
    rows = list(csv.DictReader(file.read_text().splitlines())) if file.exists() else []
    return [row["handler_p99_s"] for row in rows if row["module"] == "slow" and row["handler_p99_s"]]


def by_psutil(pid: int) -> dict[str, Any]:
    process = psutil.Process(pid)
    times, memory = process.cpu_times(), process.memory_info()
    return {
        "cpu_s": times.user + times.system,
        "rss": memory.rss,
        "threads": process.num_threads(),
        "start": process.create_time(),
    }


def busy_s() -> list[float]:
    return [
        times.user + times.nice + times.system + times.irq + times.softirq + times.steal
        for times in psutil.cpu_times(percpu=True)
    ]


def read_between_messages(observer: RunObserver) -> RunReading:
    """Read figures of channels that all are of the same moment."""
    while (now := observer.read()).channels != tuple(observer.channels()):
        pass
    return now


def is_over(now: RunReading) -> bool:
    """Whether the load is over, and everything handled."""
    scans = {one.topic: one.messages for one in now.channels if one.type_name == LaserScan.type_name}
    said = {one.name: one.status for one in now.modules}
    done = all(said[topic] == f"sent {messages}" for topic, messages in scans.items())
    return done and not any(books.waiting for name in HEARERS for books in subscriptions(now, name))


def subscriptions(now: RunReading, name: str) -> tuple[Any, ...]:
    module = now.module(name)
    assert module is not None
    return module.subscriptions


def counted_calls(observer: RunObserver, now: RunReading) -> dict[str, list[float]]:
    """Count system calls of the core and a module for each message: unwatched, then watched."""
    if shutil.which("strace") is None:
        return {}
    found: dict[str, list[float]] = {"core": [], "hanger": []}
    for is_watched in (False, True):
        tracers = {name: strace(now, name) for name in found}
        routed, end_s = observer.routed, time.monotonic() + QUIET_S
        while time.monotonic() < end_s:
            if is_watched:
                observer.read()
            time.sleep(0.05)
        routed = observer.routed - routed
        for name, tracer in tracers.items():
            tracer.send_signal(signal.SIGINT)
            _, report = tracer.communicate(timeout=20)
            totals = [line.split() for line in report.splitlines() if line.endswith(" total")]
            found[name].append(int(totals[0][3]) / routed if totals else math.nan)
    return found


def strace(now: RunReading, name: str) -> "subprocess.Popen[str]":
    module = now.module(name)
    assert module is not None
    tracer = subprocess.Popen(
        ["strace", "-c", "-f", "-p", str(module.pid)], stderr=subprocess.PIPE, text=True
    )
    assert tracer.stderr is not None
    tracer.stderr.readline()  # that it has attached, or why it may not
    return tracer


def while_core_dies(run_id: str) -> list[int]:
    """Read repeatedly while the core is killed and restarted."""
    shown: list[int] = []
    with closing(RunFeed(run_id)) as feed:
        first = feed.poll()
        assert first.reading is not None
        core = first.reading.modules[-1]
        os.kill(core.pid, signal.SIGKILL)

        def is_back() -> bool:
            snapshot = feed.poll()
            assert snapshot.watching is Watching.RUN
            assert snapshot.reading is not None
            shown.append(len(snapshot.reading.modules))
            now = snapshot.reading.modules[-1]
            return now.restarts == 1 and snapshot.reading.core.heartbeat_ns > core.busy_since_ns

        wait_until(is_back)
    return shown
