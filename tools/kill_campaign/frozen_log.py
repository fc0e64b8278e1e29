"""A disk for the robot's logs that freezes from time to time, and a check that the robot does not suffer."""

import contextlib
import random
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robbie_mp.run.trace.reader import LOG_FOLDER
from tools.kill_campaign.attack import Signalled
from tools.loop_disk import LoopDisk, NoLoopDisk
from tools.robot import Robot

MEAN_PAUSE_S = 8.0
SHORTEST_S = 1.0
LONGEST_S = 12.0
RESTART_S = 3.0
MAX_FROZEN_S = 30.0
"""After this time the disk's watchdog thaws the disk, even if the campaign has died."""


@contextlib.contextmanager
def log_disk(output: Path) -> Iterator[LoopDisk | None]:
    """Put the logs of a run on a separate disk. Where that is impossible, say so and yield None.

    Args:
        output: folder where the run will write. It must not exist yet.
    """
    logs = output / LOG_FOLDER
    logs.mkdir(parents=True)
    try:
        disk = LoopDisk(256 << 20, MAX_FROZEN_S, logs).__enter__()
    except NoLoopDisk as error:
        print(
            f"NOT TESTED: the log disk is never frozen, because this machine does not allow one: {error}",
            file=sys.stderr,
        )
        yield None
        return
    try:
        yield disk
    finally:
        disk.__exit__(None, None, None)


@dataclass
class FrozenLog:
    """Freezes and thaws the disk at random moments.

    Args:
        disk: the logs' disk.
        robot: the robot, RUNNING.
        seed: random seed of all choices.

    Attributes:
        frozen_ns: begin and end of each freeze, on the monotonic clock.
        restarts: number of processes restarted while the disk was frozen.
    """

    disk: LoopDisk
    robot: Robot
    seed: int
    frozen_ns: list[tuple[int, int]] = field(default_factory=list)
    restarts: int = 0

    def __post_init__(self) -> None:
        """Begin with a pause."""
        self._random = random.Random(self.seed)
        self._began_ns: int | None = None
        self._restarts_before = 0
        self._next_s = time.monotonic() + self._random.expovariate(1 / MEAN_PAUSE_S)

    def look(self) -> None:
        """Freeze or thaw the disk when it is time. Call this often."""
        if time.monotonic() < self._next_s:
            return
        if self._began_ns is None:
            self._restarts_before = self._count()
            self._began_ns = time.monotonic_ns()
            self.disk.freeze()
            self._next_s = time.monotonic() + self._random.uniform(SHORTEST_S, LONGEST_S)
        else:
            self.finish()

    def finish(self) -> None:
        """Thaw the disk if it is frozen."""
        if self._began_ns is not None:
            self.restarts += self._count() - self._restarts_before
            self.frozen_ns.append((self._began_ns, time.monotonic_ns()))
            self._began_ns = None
            self.disk.thaw()
        self._next_s = time.monotonic() + self._random.expovariate(1 / MEAN_PAUSE_S)

    def during(self, kills: list[Signalled], left_s: float = 0.0) -> list[Signalled]:
        """Return the kills that fell into a freeze, at least a given time before its end."""
        left_ns = left_s * 1e9
        return [
            kill
            for kill in kills
            if any(begin <= kill.at_ns < end - left_ns for begin, end in self.frozen_ns)
        ]

    def report(self, kills: list[Signalled], recovery: dict[str, dict[str, float]]) -> dict[str, Any]:
        """Return what the disk did.

        Args:
            kills: all kills of the campaign.
            recovery: recovery times of the kills that `during` returns.
        """
        return {
            "standstills": len(self.frozen_ns),
            "frozen_s": round(sum(end - begin for begin, end in self.frozen_ns) / 1e9, 1),
            "kills_while_frozen": len(self.during(kills)),
            "restarts_while_frozen": self.restarts,
            "recovery_while_frozen": recovery,
        }

    def violations(self, kills: list[Signalled]) -> list[str]:
        """Check that half the processes killed well before a freeze's end were restarted during the freeze.

        Not all of them must be, because a victim may wait for another process or may have been killed again.
        """
        killed = len(self.during(kills, RESTART_S))
        if self.restarts < killed / 2:
            return [f"{killed} were killed while the log disk was frozen, {self.restarts} were started then"]
        return []

    def _count(self) -> int:
        return sum(module.restarts for module in self.robot.figures().values())
