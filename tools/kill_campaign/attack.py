"""Kills and stops processes of a robot at random moments."""

import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tools.robot import Robot

CORE = "core"
RECOVERY_S = 0.5
"""A victim is usually still recovering for this long after a kill."""
CORE_REST_S = 11.0
"""The supervisor limits the core's restarts. After 10 s of running, the core has its full budget again."""
KINDS = {
    "one module": 10,
    "two at once": 2,
    "during a recovery": 3,
    "core": 3,
    "core and module": 1,
    "stop": 3,
}


@dataclass(frozen=True)
class Signalled:
    """A signal that was sent to a living process."""

    kind: str
    name: str
    pid: int
    incarnation: int
    at_ns: int
    """Monotonic clock, just before the signal."""


@dataclass
class Attack:
    """A campaign against one robot.

    Args:
        robot: the robot, RUNNING.
        seed: random seed of all choices.
        mean_pause_s: mean time between attacks.
        longest_stop_s: maximum time for which a process is stopped.
        spared: names of processes that are never killed or stopped.
        each_second: called about once a second.
        each_look: called about twenty times a second.

    Attributes:
        kills, stops: the signals sent.
    """

    robot: Robot
    seed: int
    mean_pause_s: float = 0.3
    longest_stop_s: float = 10.0
    spared: frozenset[str] = frozenset()
    each_second: Callable[[Robot], None] | None = None
    each_look: Sequence[Callable[[], None]] = ()
    kills: list[Signalled] = field(default_factory=list)
    stops: list[Signalled] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Start with no process stopped."""
        self._random = random.Random(self.seed)
        self._stopped: dict[int, float] = {}
        self._core_rests_until_s = 0.0
        self._next_second_s = 0.0

    def run(self, kills: int, deadline_s: float = float("inf")) -> None:
        """Attack until a number of kills, a time of the monotonic clock, or the end of the run."""
        while len(self.kills) < kills and time.monotonic() < deadline_s and self.robot.is_up:
            self._pause(self._random.expovariate(1 / self.mean_pause_s))
            kind = self._random.choices(list(KINDS), list(KINDS.values()))[0]
            self._attack(kind)

    def finish(self) -> None:
        """Resume all stopped processes."""
        for pid in list(self._stopped):
            self._continue(pid)

    def count(self) -> dict[str, int]:
        """Kills by kind, and stops."""
        return dict(Counter(kill.kind for kill in self.kills)) | {"stops": len(self.stops)}

    def _attack(self, kind: str) -> None:
        core_may = CORE not in self.spared and time.monotonic() >= self._core_rests_until_s
        modules = [name for name in self.robot.figures() if name not in {CORE, *self.spared}]
        first, second = self._random.sample(modules, 2)
        if kind == "stop":
            self._stop(self._random.choice([*modules, CORE] if core_may else modules))
        elif kind == "one module":
            self._kill(kind, first)
        elif kind == "two at once":
            self._kill(kind, first, second)
        elif kind == "during a recovery":
            self._kill("one module", first)
            self._pause(self._random.uniform(0, RECOVERY_S))
            again = self._random.random()
            later = first if again < 0.3 else CORE if again < 0.5 and core_may else second
            self._kill(kind, later)
        elif kind == "core" and core_may:
            self._kill(kind, CORE)
            if self._random.random() < 0.3:
                self._pause(self._random.uniform(0, RECOVERY_S))
                self._kill("during a recovery", CORE)
        elif kind == "core and module" and core_may:
            self._kill(kind, CORE, first)

    def _kill(self, kind: str, *names: str) -> None:
        """Kill several processes as nearly at the same time as signals allow."""
        figures = self.robot.figures()
        for name in names:
            pid, incarnation, at_ns = figures[name].pid, figures[name].incarnation, time.monotonic_ns()
            known = {kill.pid for kill in self.kills[-20:]}
            if pid and pid not in known and self.robot.send(pid, signal.SIGKILL):
                self.kills.append(Signalled(kind, name, pid, incarnation, at_ns))
                self._stopped.pop(pid, None)
                self._let_rest(name)

    def _stop(self, name: str) -> None:
        figures, at_ns = self.robot.figures()[name], time.monotonic_ns()
        pid = figures.pid
        if pid and pid not in self._stopped and self.robot.send(pid, signal.SIGSTOP):
            self.stops.append(Signalled("stop", name, pid, figures.incarnation, at_ns))
            share = self._random.random() ** 2  # short stops are more frequent than long ones
            self._stopped[pid] = time.monotonic() + share * self.longest_stop_s
            self._let_rest(name)

    def _let_rest(self, name: str) -> None:
        if name == CORE:
            self._core_rests_until_s = time.monotonic() + CORE_REST_S

    def _pause(self, length_s: float) -> None:
        """Wait, and resume processes that have been stopped for long enough."""
        until_s = time.monotonic() + length_s
        while (left_s := until_s - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.05))
            for look in self.each_look:
                look()
            for pid, end_s in list(self._stopped.items()):
                if time.monotonic() >= end_s:
                    self._continue(pid)
            if self.each_second is not None and time.monotonic() >= self._next_second_s:
                self._next_second_s = time.monotonic() + 1.0
                self.each_second(self.robot)

    def _continue(self, pid: int) -> None:
        del self._stopped[pid]
        self.robot.send(pid, signal.SIGCONT)
