"""The figures of all processes and channels, read once a second for all panels and pages."""

import time
from collections import deque

from robbie_mp.bus.observe import RunObserver, RunRates, RunReading, rates_between
from robbie_mp.run.plan import RunPlan

REFRESH_S = 1.0
DESCRIBED_READINGS = 10
"""Number of readings over which quantiles are computed."""


PLAYBACK_CLASS = "robbie_mp.logs.playback.module:Playback"


def log_source(plan: RunPlan) -> str:
    """Return the name of the module whose log drives the run's clock; '' if there is none."""
    found = (
        one.name for one in plan.modules if one.name == plan.clock.source and one.class_path == PLAYBACK_CLASS
    )
    return next(found, "")


class RunWatch:
    """Reads the run that the station is part of.

    Args:
        run_id: the run.

    Attributes:
        reading: the newest reading; None before the first.
        rates: rates between the last two readings; None before the second.
        count: number of readings. A page compares it to find out whether it has shown the newest one.
    """

    def __init__(self, run_id: str):
        self._observer = RunObserver(run_id)
        self._readings: deque[RunReading] = deque(maxlen=DESCRIBED_READINGS)
        self.reading: RunReading | None = None
        self.rates: RunRates | None = None
        self.count = 0

    def tick(self) -> None:
        """Read the figures if that is due; called in the module's thread."""
        if self.reading is not None and time.monotonic_ns() - self.reading.at_ns < REFRESH_S * 1e9:
            return
        before, reading = self.reading, self._observer.read()
        self._readings.append(reading)
        if before is not None:
            self.rates = rates_between(before, reading, long_before=self._readings[0])
        self.reading = reading
        self.count += 1

    def close(self) -> None:
        """Unmap the run."""
        self._observer.close()
