"""Runs the robot once, with clients or without, and returns the figures."""

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from robbie_mp.observe.rates import rates_between
from tools.bench.contender import work_folder
from tools.foxglove_load.modules import NAME
from tools.kill_campaign.robot import COMMAND, LIMIT_S, Robot
from tools.logger_load.measure import latency_of

Result = dict[str, Any]

WITHOUT, THREE, STOPPED = "without", "three", "stopped"
CLIENTS: dict[str, list[list[str]]] = {WITHOUT: [], THREE: [[]] * 3, STOPPED: [["--stopped"]]}
"""The options of the clients of each session."""
CLIENT = Path(__file__).parent / "client.py"
SERVER = "foxglove"
PAIRS = 4
SMALL_HZ = 800.0
SETTLE_S = 3.0
MEGABYTE = 1e6


def profile() -> dict[str, Any]:
    """Return a profile with a camera, its viewer, pairs that exchange small messages, and the server."""
    shared = "tools.logger_load.modules"
    modules: dict[str, Any] = {"viewer": {"class": f"{shared}:Viewer"}}
    for number in range(PAIRS):
        rate = {"number": number, "rate_hz": SMALL_HZ / PAIRS}
        modules[f"listener{number}"] = {"class": f"{shared}:Listener", "settings": {"number": number}}
        modules[f"talker{number}"] = {"class": f"{shared}:Talker", "settings": rate}
    modules["camera"] = {"class": "tools.foxglove_load.modules:Camera"}
    server = "robbie_mp.services.foxglove:FoxgloveServer"
    modules[SERVER] = {"class": server, "settings": {"port": 0}}
    return {"modules": modules}


class Reader:
    """A client in a process of its own."""

    def __init__(self, link: str, options: list[str]):
        command = [sys.executable, str(CLIENT), link, NAME, *options]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout
        self._process.stdout.readline()

    def bytes(self) -> int:
        """Return the number of bytes read so far."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


@contextlib.contextmanager
def robot_with_server() -> Iterator[tuple[Robot, str]]:
    """Run the robot; yield it and the link of its server."""
    with work_folder() as (_, folder):
        (folder / "profiles").mkdir()
        (folder / "profiles" / "load.yaml").write_text(yaml.safe_dump(profile(), sort_keys=False))
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


def measure(robot: Robot, link: str, session: str, seconds: float, settle_s: float = SETTLE_S) -> Result:
    """Return the figures of one session of a robot that runs.

    Args:
        robot: the robot.
        link: of its server.
        session: which clients there are: `without`, `three` or `stopped`.
        seconds: how long figures are taken.
        settle_s: time before that, s.
    """
    with contextlib.ExitStack() as ended:
        readers = [ended.enter_context(contextlib.closing(Reader(link, one))) for one in CLIENTS[session]]
        time.sleep(settle_s)
        assert robot.observer is not None
        before, read = robot.observer.read(), [one.bytes() for one in readers]
        time.sleep(seconds)
        now, read_now = robot.observer.read(), [one.bytes() for one in readers]
    rates = rates_between(before, now)
    took_s = (now.at_ns - before.at_ns) / 1e9
    return {
        "session": session,
        "small": latency_of(before, now, [f"listener{number}" for number in range(PAIRS)]),
        "image": latency_of(before, now, ["viewer"]),
        "server_percent": rates.modules[SERVER].cpu_percent,
        "machine_percent": sum(rates.cpu_percent) / len(rates.cpu_percent),
        "client_mb_per_s": [
            (after - earlier) / MEGABYTE / took_s for earlier, after in zip(read, read_now, strict=True)
        ],
    }
