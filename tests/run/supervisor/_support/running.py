"""Runs a process tree of zoo children in the test's own process, with a scenario."""

import dataclasses
import os
import secrets
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path

from robbie_mp.base.linux.proc import read_stat
from robbie_mp.run.profile.model import ModuleSpec, RestartPolicy, RestartWhen, TraceSettings
from robbie_mp.run.supervisor.child_spec import ChildKind, ChildSpec
from robbie_mp.run.supervisor.incarnations import Doing
from robbie_mp.run.supervisor.output import OutputStore
from robbie_mp.run.supervisor.spares import SpareCommand
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.tree import Tree
from robbie_mp.run.trace.crash import CrashReport, LastWords
from robbie_mp.run.trace.entry import Entry
from tests._support.debugger import is_held
from tests._support.places import PROJECT
from tests.run.supervisor._support import zoo

LIMIT_S = 10.0
QUICK = RestartPolicy(max_restarts=2, within_s=60.0, backoff_s=0.001, backoff_cap_s=0.002, retry_s=0.0)
NEVER = dataclasses.replace(QUICK, policy=RestartWhen.NEVER)
ALWAYS = dataclasses.replace(QUICK, policy=RestartWhen.ALWAYS)

Scenario = Generator[Callable[[], bool], None, None]


class FolderIncarnations:
    """Incarnations without memory: readiness is a file; every call is recorded, and its order is checked."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.calls: list[tuple[str, str, int]] = []
        self.changes: list[StateChange] = []
        self.pids: dict[tuple[str, int], int] = {}
        self.refuses: set[str] = set()
        self.busy: dict[str, Doing] = {}
        self.time_sources: set[str] = set()
        """Modules that have not set the run's time yet; all others wait for them."""
        self.reclaims_at_once = False
        self.closed = 0
        self.times_all_started = 0
        self._reclaim_asked: set[tuple[str, int]] = set()

    def open(self, name: str, incarnation: int) -> None:
        if incarnation > 1:
            assert ("reclaimed", name, incarnation - 1) in self.calls or name in self.refuses
        self.calls.append(("open", name, incarnation))
        if name in self.refuses:
            raise OSError("no room")

    def started(self, name: str, incarnation: int, pid: int) -> None:
        assert self.calls[-1] == ("open", name, incarnation)
        self.calls.append(("started", name, incarnation))
        self.pids[name, incarnation] = pid

    def is_ready(self, name: str, incarnation: int) -> bool:
        return (self.folder / f"{name}.{incarnation}.ready").exists()

    def has_ended(self, name: str, incarnation: int) -> bool:
        assert ("died", name, incarnation) not in self.calls
        return True

    def awaits_time(self, name: str) -> bool:
        return bool(self.time_sources - {name})

    def doing(self, name: str, incarnation: int) -> Doing | None:
        assert ("open", name, incarnation) in self.calls
        return self.busy.get(name)

    def describe(self, name: str, incarnation: int, doing: Doing) -> str:
        return f"hung in {doing.activity.name.lower()} {doing.subscription}"

    def last_words(self, name: str, incarnation: int) -> LastWords:
        assert ("died", name, incarnation) not in self.calls
        return LastWords(activity="its duty")

    def keep_evidence(self, report: CrashReport) -> None:
        assert ("died", report.module, report.incarnation) not in self.calls

    def died(self, name: str, incarnation: int, *, was_ordered: bool = False) -> None:
        assert ("died", name, incarnation) not in self.calls
        assert ("open", name, incarnation) in self.calls
        if pid := self.pids.get((name, incarnation)):
            assert read_stat(pid) is None or is_held(pid), "told of a death before it was reaped"
        self.calls.append(("died", name, incarnation))

    def is_reclaimed(self, name: str, incarnation: int) -> bool:
        assert ("died", name, incarnation) in self.calls
        if not self.reclaims_at_once and (name, incarnation) not in self._reclaim_asked:  # it takes a while
            self._reclaim_asked.add((name, incarnation))
            return False
        self.calls.append(("reclaimed", name, incarnation))
        return True

    def wake(self, name: str, incarnation: int) -> None:
        self.calls.append(("wake", name, incarnation))

    def state_changed(self, change: StateChange) -> None:
        self.changes.append(change)

    def are_subscribed(self) -> bool:
        return True

    def all_started(self) -> None:
        self.times_all_started += 1

    def close(self) -> None:
        self.closed += 1

    def forked(self, name: str, incarnation: int = 1) -> list[int]:
        """Pids that a forking animal said it forked."""
        return [int(pid) for pid in (self.folder / f"{name}.{incarnation}.forked").read_text().split()]


class Run:
    """One tree, with everything that a test can check afterwards."""

    def __init__(
        self,
        folder: Path,
        *specs: ChildSpec,
        run_id: str = "",
        limits: TraceSettings | None = None,
        wall_clock: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
        spares: SpareCommand | None = None,
    ):
        folder.joinpath("ready").mkdir()
        self.incarnations = FolderIncarnations(folder / "ready")
        self.lines: list[Entry] = []
        self.logs = folder / "logs"
        self.turns = 0
        self.each_turn: Callable[[], None] = lambda: None
        self._scenario: Scenario | None = None
        self._condition: Callable[[], bool] = lambda: True
        self._limit_s = 0.0
        store = OutputStore(self.logs, self.lines.append, limits)
        try:
            self.tree = Tree(
                [
                    dataclasses.replace(spec, argv=(*spec.argv, str(folder / "ready"), str(os.getpid())))
                    for spec in specs
                ],
                run_id or secrets.token_hex(4),
                self.incarnations,
                store,
                self._each_turn,
                wall_clock,
                clock,
                spares,
            )
        except BaseException:
            store.close()
            raise

    def play(self, scenario: Scenario | None = None) -> int:
        """Run to the end; the scenario yields what it waits for. Its end does not end the run."""
        self._scenario = scenario
        self._wait_until(lambda: True)
        return self.tree.run()

    def states(self, name: str) -> list[ChildState]:
        return [change.new for change in self.incarnations.changes if change.name == name]

    def last(self, name: str) -> StateChange:
        return [change for change in self.incarnations.changes if change.name == name][-1]

    def all_running(self) -> bool:
        return all(child.state is ChildState.RUNNING for child in self.tree.children)

    def is_running(self, name: str) -> bool:
        return self.tree.child(name).state is ChildState.RUNNING

    def text(self, name: str, stream: str) -> list[str]:
        return [line.text for line in self.lines if line.module == name and line.stream == stream]

    def _wait_until(self, condition: Callable[[], bool]) -> None:
        self._condition = condition
        self._limit_s = time.monotonic() + LIMIT_S

    def _each_turn(self) -> None:
        self.turns += 1
        self.each_turn()
        assert time.monotonic() < self._limit_s, f"waited {LIMIT_S} s; {self.incarnations.changes}"
        if self._scenario is not None and self._condition():
            try:
                self._wait_until(next(self._scenario))
            except StopIteration:
                self._scenario = None
                self._limit_s = time.monotonic() + LIMIT_S


def animal(behaviour: Callable[[zoo.Animal], None], name: str = "", **fields: object) -> ChildSpec:
    """Describe a child of the zoo; its restarts are quick."""
    settings: dict[str, object] = {
        "restart": QUICK, "start_deadline_s": 5.0, "handler_deadline_s": 0.0, **fields,
    }  # fmt: skip
    argv = (sys.executable, "-S", zoo.__file__, behaviour.__name__)
    own = {key: settings.pop(key) for key in ("kind", "may_be_warm") if key in settings}
    module = ModuleSpec(name or behaviour.__name__, "", **settings)  # type: ignore[arg-type]
    return ChildSpec(module, argv, {"PYTHONPATH": str(PROJECT)}, **own)  # type: ignore[arg-type]


def core(behaviour: Callable[[zoo.Animal], None] = zoo.works) -> ChildSpec:
    """Describe a core."""
    return animal(behaviour, "core", kind=ChildKind.CORE, restart=NEVER)


def is_gone(pid: int) -> bool:
    """Whether a process has ended; a zombie that its parent has not noticed yet has."""
    stat = read_stat(pid)
    return stat is None or stat.is_dead


def wait_for(condition: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
    """Wait until something is so, outside of a tree."""
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s, f"not so within {limit_s} s"
        time.sleep(0.002)
