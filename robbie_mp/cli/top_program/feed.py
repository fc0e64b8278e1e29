"""Supplies the program with figures: finds the run, follows it to its end, and finds the next one."""

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto

from robbie_mp.bus.observe import RunObserver, RunRates, RunReading, rates_between
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.cli.runs import live_runs, matching_runs
from robbie_mp.run.run_directory import KnownRun, is_live

DESCRIBED_READINGS = 10
"""Quantiles cover the time since this many readings ago."""
KEPT_VALUES = 120
"""Values kept for each sparkline."""


class Watching(Enum):
    """Whether there is a run to watch."""

    NOTHING = auto()
    """There is no run."""
    SEVERAL = auto()
    """There are several runs, and the user has chosen none."""
    RUN = auto()
    ENDED = auto()
    """The run has ended; its last reading is still shown."""


@dataclass(frozen=True)
class Snapshot:
    """The data that the program shows at one time."""

    watching: Watching
    runs: tuple[KnownRun, ...]
    """The live runs that match the request."""
    run: KnownRun | None = None
    reading: RunReading | None = None
    rates: RunRates | None = None


class Sparklines:
    """The last values for each sparkline, by name."""

    def __init__(self) -> None:
        self._values: dict[tuple[str, ...], deque[float]] = {}

    def add(self, rates: RunRates) -> None:
        """Keep the values of one interval."""
        self._keep(("routed",), rates.routed_hz)
        for name, module in rates.modules.items():
            self._keep(("module", name, "in"), module.in_hz)
            self._keep(("module", name, "out"), module.out_hz)
            self._keep(("module", name, "cpu"), module.cpu_percent)
            self._keep(("module", name, "latency"), module.latency.p99_s or 0.0)
            self._keep(("module", name, "handler"), module.handler.p99_s or 0.0)
        for (type_name, version, topic), channel in rates.channels.items():
            self._keep(("channel", type_name, str(version), topic), channel.hz)

    def values(self, *name: str) -> list[float]:
        """Return the values kept under a name, the newest last."""
        return list(self._values.get(name, ()))

    def clear(self) -> None:
        """Forget all values: another run is watched."""
        self._values.clear()

    def _keep(self, name: tuple[str, ...], value: float) -> None:
        self._values.setdefault(name, deque(maxlen=KEPT_VALUES)).append(value)


class RunFeed:
    """Reads one run, and follows from run to run.

    Args:
        named: the wanted run, as `matching_runs` takes it.
    """

    def __init__(self, named: str | None = None):
        self._named = named
        self._run: KnownRun | None = None
        self._observer: RunObserver | None = None
        self._readings: deque[RunReading] = deque(maxlen=DESCRIBED_READINGS)
        self.history = Sparklines()

    def poll(self) -> Snapshot:
        """Take a reading now."""
        runs = self._wanted()
        if self._run is not None and self._observer is not None and is_live(self._run.folder):
            return self._read(runs)
        if len(runs) == 1 and self._attach(runs[0]):
            return self._read(runs)
        if self._readings:
            return self._shown(Watching.ENDED, runs)
        return Snapshot(Watching.SEVERAL if len(runs) > 1 else Watching.NOTHING, runs)

    def choose_next(self) -> None:
        """Watch the next of the live runs that match the request."""
        runs = self._wanted()
        known = [run.run_id for run in runs]
        if not runs:
            return
        place = known.index(self._run.run_id) + 1 if self._run and self._run.run_id in known else 0
        self._attach(runs[place % len(runs)])

    def close(self) -> None:
        """Unmap the run that is watched."""
        if self._observer is not None:
            self._observer.close()
            self._observer = None

    def _wanted(self) -> tuple[KnownRun, ...]:
        return tuple(matching_runs(self._named, live_runs()))

    def _attach(self, run: KnownRun) -> bool:
        try:
            observer = RunObserver(run.run_id)
        except (SegmentMissing, SegmentMismatch):  # the run is just starting, or has another version
            return False
        self.close()
        self._run, self._observer = run, observer
        self._readings.clear()
        self.history.clear()
        return True

    def _read(self, runs: tuple[KnownRun, ...]) -> Snapshot:
        assert self._observer is not None
        self._readings.append(self._observer.read())
        shown = self._shown(Watching.RUN, runs)
        if shown.rates:
            self.history.add(shown.rates)
        return shown

    def _shown(self, watching: Watching, runs: tuple[KnownRun, ...]) -> Snapshot:
        readings = self._readings
        rates = None
        if len(readings) > 1:
            rates = rates_between(readings[-2], readings[-1], long_before=readings[0])
        return Snapshot(watching, runs, self._run, readings[-1], rates)
