"""The time from a kill until the process works again."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence

import numpy as np

from tools.kill_campaign.attack import CORE, Signalled
from tools.kill_campaign.records import ModuleRecord

Statistics = dict[str, float]


def recovery_times(kills: Iterable[Signalled], records: dict[str, ModuleRecord]) -> dict[str, Statistics]:
    """Times from a kill to the next message: of modules, handled or published; of the core, routed.

    For the core it is the time until the first handler is entered for a message published after the kill. If
    a victim had no message to handle for a while, that time counts. If it was killed again before it worked,
    the time counts until it finally worked.
    """
    pairs = [_by_publication(record) for record in records.values() if record.entered_ns]
    found: dict[str, list[float]] = {"module": [], CORE: []}
    for kill in kills:
        if kill.name == CORE:
            after = (_next(published, entered, kill.at_ns) for published, entered in pairs)
            worked = min((at_ns for at_ns in after if at_ns is not None), default=None)
            found[CORE] += [] if worked is None else [(worked - kill.at_ns) / 1e9]
        elif kill.name in records:  # the modules that call have none
            began = records[kill.name].worked_ns
            at = bisect_right(began, kill.at_ns)
            found["module"] += [(began[at] - kill.at_ns) / 1e9] if at < len(began) else []
    return {what: statistics_s(times) for what, times in found.items() if times}


def _by_publication(record: ModuleRecord) -> tuple[np.ndarray, np.ndarray]:
    entered = np.array(record.entered_ns)
    published = entered - np.array(record.latency_ns)
    order = np.argsort(published, kind="stable")
    return published[order], entered[order]


def _next(published: np.ndarray, entered: np.ndarray, at_ns: int) -> int | None:
    at = int(np.searchsorted(published, at_ns, side="right"))
    return int(entered[at : at + 50].min()) if at < len(published) else None


def statistics_s(times_s: Sequence[float]) -> Statistics:
    """Number, median, 95th percentile and maximum."""
    return {
        "count": len(times_s),
        "p50_s": round(float(np.percentile(times_s, 50)), 3),
        "p95_s": round(float(np.percentile(times_s, 95)), 3),
        "max_s": round(float(max(times_s)), 3),
    }
