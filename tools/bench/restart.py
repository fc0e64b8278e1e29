"""The benchmark `restart`: how long a killed module is away. No peer restarts processes."""

import signal
import time
from functools import partial
from pathlib import Path
from typing import Any

from tools.bench.contender import Trouble, work_folder
from tools.bench.options import Options
from tools.bench.restart_modules import JOURNAL
from tools.journal import read_journal
from tools.robot import Robot, running

MODULES = "tools.bench.restart_modules"
UNLIMITED = {"max_restarts": 1 << 20, "stable_after_s": 0.0}
PAUSE_S = 0.3
"""Time between a restart and the next kill."""


def restart(options: Options) -> list[dict[str, Any]]:
    """Kill a module with SIGKILL again and again, with a spare interpreter and without one."""
    kills = options.messages(30, 10)
    subjects = {"robbie small": 1, "robbie small, no spares": 0}
    title = f"SIGKILL until the restarted module handles a message, {kills} kills"
    rows = [
        _row(name, kills, spares, options) for name, spares in subjects.items() if spares or not options.quick
    ]
    return [{"benchmark": "restart", "title": title, "kind": "restart", "contenders": rows}]


def _row(name: str, kills: int, spares: int, options: Options) -> dict[str, Any]:
    row = {"name": name, "title": name.removeprefix("robbie "), "version": "", "trouble": "", "rounds": []}
    try:
        return row | {"away_ms": options.watched(partial(measure, kills, spares))}
    except Trouble as trouble:
        return row | {"trouble": str(trouble)}


def measure(kills: int, spares: int) -> list[float]:
    """Return the time from each kill until the handler of the next process was entered, ms."""
    modules = {
        "source": {"class": f"{MODULES}:Source"},
        "subject": {"class": f"{MODULES}:Subject", "restart": UNLIMITED},
    }
    profile = {"modules": modules, "spares": {"count": spares}}
    with work_folder() as (_, folder), running(folder, profile) as robot:
        robot.wait_until_running()
        journal = robot.output / JOURNAL
        away_ms: list[float] = []
        _wait_for(robot, 1, "no message was handled")
        for number in range(2, kills + 2):
            if spares:
                robot.wait_for_spare()
            time.sleep(PAUSE_S)
            killed_ns = time.monotonic_ns()
            robot.send(robot.figures()["subject"].pid, signal.SIGKILL)
            _wait_for(robot, number, "the killed module is not back")
            away_ms.append((_times_ns(journal)[-1] - killed_ns) / 1e6)
        return away_ms


def _wait_for(robot: Robot, starts: int, otherwise: str) -> None:
    """Wait until `starts` processes of the subject have each handled a message."""
    robot.wait_for(lambda: len(_times_ns(robot.output / JOURNAL)) >= starts, otherwise)


def _times_ns(journal: Path) -> list[int]:
    return [int(words[1]) for words in read_journal(journal)]
