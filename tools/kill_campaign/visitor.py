"""`python -m tools.kill_campaign.visitor RUN JOURNAL`: an attached tool that comes and goes.

It subscribes to what the painters publish, journals it as a subscriber of the robot does (see
`tools.kill_campaign.latched`), detaches, and attaches again. The campaign kills it from time to time.
"""

import random
import subprocess
import sys
import time
from itertools import cycle
from pathlib import Path

from robbie_mp.attached.tool.tool import Detached, RunEnded, Tool
from robbie_mp.run.control import ControlRefused
from robbie_mp.run.live_runs import choose_run
from robbie_mp.run.run_directory import KnownRun
from tools.journal import Journal, read_journal
from tools.kill_campaign.latched import LATCHED, VISITOR, Painting, note_painting
from tools.robot import REPOSITORY, Robot

VISITS_S = (0.2, 1.0, 3.0)
"""How long the tool stays, in turn."""
MEAN_LIFE_S = 8.0
POLL_S = 0.05


class Visitors:
    """Starts the tool, kills it from time to time, and starts it again.

    Args:
        robot: the robot, RUNNING.
        seed: random seed of the moments.
    """

    def __init__(self, robot: Robot, seed: int):
        self._robot = robot
        self._random = random.Random(seed)
        self._tool: subprocess.Popen[bytes] | None = None
        self._end_s = 0.0
        self.kills = 0

    def look(self) -> None:
        """Start the tool, or kill it when it is time. Call this often."""
        if self._tool is None or self._tool.poll() is not None:
            self._end_s = time.monotonic() + self._random.expovariate(1 / MEAN_LIFE_S)
            self._tool = self._start()
        elif time.monotonic() >= self._end_s:
            self.finish()
            self.kills += 1

    def finish(self) -> None:
        """Kill the tool if it runs."""
        if self._tool is not None:
            self._tool.kill()
            self._tool.wait()
            self._tool = None

    def last_visit(self) -> None:
        """Attach once more, to a robot at rest, until every latched message is there."""
        self._tool = self._start("--once")
        self._robot.wait_for(self._has_left, "an attached tool did not get every latched message")
        self._tool = None

    def _has_left(self) -> bool:
        return self._tool is not None and self._tool.poll() is not None

    def _start(self, *options: str) -> subprocess.Popen[bytes]:
        journal = self._robot.output / f"{VISITOR}.journal"
        command = [sys.executable, "-m", "tools.kill_campaign.visitor", self._robot.run_id, str(journal)]
        return subprocess.Popen([*command, *options], cwd=REPOSITORY, env=self._robot.environment)


def main(arguments: list[str]) -> None:
    """Visit the run until it ends; with `--once`, until every latched message has come."""
    run_id, journal_path, *options = arguments
    path = Path(journal_path)
    before = sum(words[0] == "S" for words in read_journal(path))
    journal = Journal(path)
    run = choose_run(run_id)
    try:
        for number, visit_s in enumerate(cycle(VISITS_S), start=before + 1):
            is_once = "--once" in options
            if _visit(run, journal, number, float("inf") if is_once else visit_s) and is_once:
                return
    except RunEnded:
        return


def _visit(run: KnownRun, journal: Journal, number: int, visit_s: float) -> bool:
    """Attach, and journal what comes; return early when the robot detaches the tool.

    Args:
        run: the run.
        journal: where to write.
        number: the number of this visit.
        visit_s: how long to stay; infinite: until every latched message has come.

    Returns:
        Whether every latched message has come.
    """
    tool = _attach(run)
    missing = set(LATCHED)
    try:
        journal.note("S", number)
        tool.subscribe(Painting.type_name, Painting.version)
        tool.ready()
        end_s = time.monotonic() + visit_s
        while time.monotonic() < end_s and (missing or visit_s < float("inf")):
            received = tool.take()
            if received is None:
                tool.wait(POLL_S)
                continue
            missing.discard(received.topic)
            note_painting(journal, received.sequence, received.topic, Painting.decode(received.data))
    except Detached:
        pass
    finally:
        tool.close()
    return not missing


def _attach(run: KnownRun) -> Tool:
    """Attach as soon as there is a place: the robot may not have freed that of a killed tool yet."""
    while True:
        try:
            return Tool(run, VISITOR)
        except ControlRefused:
            time.sleep(POLL_S)


if __name__ == "__main__":
    main(sys.argv[1:])
