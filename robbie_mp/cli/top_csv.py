"""Figures of a run as a table of comma-separated values, for recordings of hours and days."""

import csv
import sys
import time
from contextlib import ExitStack, closing
from typing import IO

from robbie_mp.attached.views.run_figures import state_name
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.utc import time_text
from robbie_mp.bus.observe import TOTALS, ModuleFigures, ModuleRates, RunObserver, RunReading, rates_between
from robbie_mp.cli.output import PlainStream
from robbie_mp.run.run_directory import KnownRun, is_live

FIGURES = (
    "pid", "incarnation", "restarts", "rss_bytes", "shared_bytes", "threads", "published", "handled",
    "refused", "waiting", "waiting_peak", "outbound_waiting", "pinned", "pinned_bytes", "copied",
    "ill_formed", "outstanding", "outstanding_bytes", "ticks_missed",
)  # fmt: skip
RATES = ("cpu_percent", "in_hz", "out_hz", "tick_hz")
TIMES = (
    ("latency", "p50_s"), ("latency", "p99_s"), ("handler", "mean_s"), ("handler", "p99_s"),
    ("handler", "max_s"), ("lateness", "p99_s"), ("tick", "p99_s"),
)  # fmt: skip
COLUMNS = (
    "time", "module", "state", *FIGURES, *(total.name for total in TOTALS), *RATES,
    *(f"{kind}_{part}" for kind, part in TIMES),
)  # fmt: skip


class FileNotWritable(RobbieError, OSError):
    """The file for the figures cannot be written."""


def record(run: KnownRun, path: str, interval_s: float, *, once: bool = False) -> int:
    """Write a line for each process and interval until the run ends, or Ctrl-C.

    Args:
        run: which run.
        path: of the file, which is overwritten; '-' for standard output.
        interval_s: time between two lines of a process; they describe the time between them.
        once: end after the first interval.

    Raises:
        FileNotWritable: the file cannot be written.
    """
    with ExitStack() as stack:
        observer = stack.enter_context(closing(RunObserver(run.run_id)))
        try:
            file = sys.stdout if path == "-" else stack.enter_context(open(path, "w", newline=""))
            return _record(run, observer, file, interval_s, once=once)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise FileNotWritable(f"cannot write the figures to {path}: {error.strerror}") from error


def _record(run: KnownRun, observer: RunObserver, file: IO[str], interval_s: float, *, once: bool) -> int:
    writer = csv.writer(PlainStream(file))
    writer.writerow(COLUMNS)
    before = observer.read()
    next_s = time.monotonic()
    while is_live(run.folder):
        next_s += interval_s
        time.sleep(max(0.0, next_s - time.monotonic()))
        now = observer.read()
        rates = rates_between(before, now)
        writer.writerows(_row(now, module, rates.modules[module.name]) for module in now.modules)
        file.flush()
        if once:
            break
        before = now
    return 0


def _row(now: RunReading, module: ModuleFigures, rates: ModuleRates) -> list[object]:
    return [
        time_text(now.wall_time_s),
        module.name,
        state_name(module),
        *(getattr(module, name) for name in FIGURES),
        *(module.total(total.name) for total in TOTALS),
        *(f"{getattr(rates, name):.6g}" for name in RATES),
        *(_time(getattr(getattr(rates, kind), part)) for kind, part in TIMES),
    ]


def _time(time_s: float | None) -> str:
    return "" if time_s is None else f"{time_s:.6g}"
