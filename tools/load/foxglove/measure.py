"""Runs the robot once, with clients or without, and returns the figures."""

import contextlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.bus.observe.figures import RunReading
from robbie_mp.bus.observe.rates import rates_between
from robbie_mp.messages import EmergencyStop
from robbie_mp.run.run_directory import list_runs
from tools.bench.contender import work_folder
from tools.load.foxglove.modules import NAME
from tools.load.logger.measure import histogram_of
from tools.robot import COMMAND, LIMIT_S, Robot, RobotTrouble
from tools.trials.devices.drivers import load

Result = dict[str, Any]


@dataclass(frozen=True)
class Session:
    """What happens while figures are taken.

    Attributes:
        clients: the options of each client.
        is_busy: whether other processes keep all processors busy.
        compared_to: the session without clients to compare with; "" for that session itself.
    """

    clients: tuple[tuple[str, ...], ...] = ()
    is_busy: bool = False
    compared_to: str = ""


READS, READS_ELSEWHERE, STOPS_READING = (), ("--elsewhere",), ("--stopped",)
WITHOUT, AGAIN, THREE, ELSEWHERE, STOPPED = "without", "without again", "three", "three elsewhere", "stopped"
BUSY_WITHOUT, BUSY_THREE = "busy, without", "busy, three"
SESSIONS = {
    WITHOUT: Session(),
    AGAIN: Session(compared_to=WITHOUT),
    THREE: Session((READS,) * 3, compared_to=WITHOUT),
    ELSEWHERE: Session((READS_ELSEWHERE,) * 3, compared_to=WITHOUT),
    STOPPED: Session((STOPS_READING,), compared_to=WITHOUT),
    BUSY_WITHOUT: Session(is_busy=True),
    BUSY_THREE: Session((READS,) * 3, is_busy=True, compared_to=BUSY_WITHOUT),
}
CLIENT = Path(__file__).parent / "client.py"
SERVER = "foxglove"
PAIRS = 4
SMALL_HZ = 800.0
SETTLE_S = 1.0
PRESSES_APART_S = 0.02, 0.1
MEGABYTE = 1e6


def profile(scheduling: Mapping[str, Any]) -> dict[str, Any]:
    """Return a profile with a camera, its viewer, a base, pairs with small messages, and the server."""
    shared = "tools.load.logger.modules"
    modules: dict[str, Any] = {"viewer": {"class": f"{shared}:Viewer"}}
    for number in range(PAIRS):
        rate = {"number": number, "rate_hz": SMALL_HZ / PAIRS}
        modules[f"listener{number}"] = {"class": f"{shared}:Listener", "settings": {"number": number}}
        modules[f"talker{number}"] = {"class": f"{shared}:Talker", "settings": rate}
    modules["camera"] = {"class": "tools.load.foxglove.modules:Camera"}
    modules["base"] = {"class": "tools.load.foxglove.modules:Base"}
    server = "robbie_mp.connect.foxglove.module:FoxgloveServer"
    modules[SERVER] = {"class": server, "settings": {"port": 0}, "scheduling": dict(scheduling)}
    return {"modules": modules}


class Reader:
    """A client in a process and a session of its own, as a panel has."""

    def __init__(self, link: str, options: Sequence[str]):
        command = [sys.executable, str(CLIENT), link, NAME, *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self._process.stdout
        self._process.stdout.readline()

    def bytes(self) -> int:
        """Return the number of bytes read so far."""
        return self._ask("")

    def press_stop(self) -> int:
        """Press the emergency stop; return when, ns of the monotonic clock."""
        return self._ask("press")

    def _ask(self, line: str) -> int:
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def robot_with_server(scheduling: Mapping[str, Any]) -> Iterator[tuple[Robot, str]]:
    """Run the robot; yield it and the link of its server.

    Args:
        scheduling: of the server, as in a profile.
    """
    with work_folder() as (_, folder):
        (folder / "profiles").mkdir()
        (folder / "profiles" / "load.yaml").write_text(yaml.safe_dump(profile(scheduling), sort_keys=False))
        with contextlib.closing(Robot(folder, folder, "load")) as robot:
            robot.wait_until_running()
            yield robot, _link(robot)
            robot.stop()


def _link(robot: Robot) -> str:
    said = ""

    def has_link() -> bool:
        nonlocal said
        command = [*COMMAND, "foxglove"]
        done = subprocess.run(
            command, env=robot.environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
        said = done.stdout.strip() or done.stderr
        return done.returncode == 0

    robot.wait_for(has_link, "the server has no link")
    return said


def measure(robot: Robot, link: str, name: str, seconds: float, settle_s: float = SETTLE_S) -> Result:
    """Return the figures of one session of a robot that runs.

    Args:
        robot: the robot.
        link: of its server.
        name: of the session.
        seconds: how long figures are taken.
        settle_s: time before that, s.
    """
    session = SESSIONS[name]
    stops_ms: list[float] = []
    with contextlib.ExitStack() as ended:
        readers = [ended.enter_context(closing(Reader(link, one))) for one in session.clients]
        if session.is_busy:
            ended.enter_context(load(os.cpu_count() or 1))
        time.sleep(settle_s)
        assert robot.observer is not None
        before, read = robot.observer.read(), [one.bytes() for one in readers]
        if session.is_busy and readers:
            stops_ms = press_stop(robot, readers[0], seconds)
        else:
            time.sleep(seconds)
        now, read_now = robot.observer.read(), [one.bytes() for one in readers]
    rates = rates_between(before, now)
    took_s = (now.at_ns - before.at_ns) / 1e9
    return {
        "session": name,
        "small": latencies_between(before, now, [f"listener{number}" for number in range(PAIRS)]),
        "image": latencies_between(before, now, ["viewer"]),
        "server_percent": rates.modules[SERVER].cpu_percent,
        "machine_percent": sum(rates.cpu_percent) / len(rates.cpu_percent),
        "client_mb_per_s": [
            (after - earlier) / MEGABYTE / took_s for earlier, after in zip(read, read_now, strict=True)
        ],
        "stops_ms": stops_ms,
    }


def latencies_between(before: RunReading, now: RunReading, names: Sequence[str]) -> list[int]:
    """Return how many messages of some modules had which latency, by the buckets of `Histogram`."""
    counts: list[int] = (histogram_of(now, names).counts - histogram_of(before, names).counts).tolist()
    return counts


def press_stop(robot: Robot, reader: Reader, seconds: float) -> list[float]:
    """Press the emergency stop again and again; return the times until the base said that it stood, ms.

    Raises:
        RobotTrouble: the base did not stop.
    """
    chance, stops_ms = random.Random(0), []
    runs = [run for run in list_runs(robot.bases) if run.run_id == robot.run_id]
    with closing(Tool(runs[0], "hears when the base stands")) as tool:
        tool.subscribe(EmergencyStop.type_name, EmergencyStop.version, "emergency_stop_state")
        tool.ready()
        tool.wait_for(tool.is_subscribed, LIMIT_S)
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            time.sleep(chance.uniform(*PRESSES_APART_S))
            pressed_ns = reader.press_stop()
            stops_ms.append((_next_published_ns(tool) - pressed_ns) / 1e6)
    return stops_ms


def _next_published_ns(tool: Tool) -> int:
    until_s = time.monotonic() + LIMIT_S
    while (received := tool.take()) is None:
        if time.monotonic() > until_s:
            raise RobotTrouble(f"the base did not stop within {LIMIT_S:g} s")
        tool.wait()
    return received.published_ns
