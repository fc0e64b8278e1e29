"""What failed, and how long until it recovered, from the supervisor's remarks about its children."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.trace.entry import Entry

_CHANGE = re.compile(r"(?P<old>\w+) → (?P<new>\w+): (?P<reason>.*)", re.DOTALL)
_AGAIN = re.compile(r", again in [\d.]+ s$")
FAILURES = (ChildState.BACKOFF, ChildState.FAILED)


@dataclass
class ModuleFailure:
    """One end of a process that was none in order; further ones before it runs again belong to it."""

    time_s: float
    """Seconds since 1970."""
    module: str
    reason: str
    times: int = 1
    recovered_s: float | None = None
    """When it ran again, seconds since 1970; None: it never did."""
    outcome: str = ""
    """The last state that is known after it."""

    @property
    def took_s(self) -> float | None:
        """How long it took to recover; None: it did not."""
        return None if self.recovered_s is None else max(0.0, self.recovered_s - self.time_s)


def failures_of(remarks: Iterable[Entry]) -> list[ModuleFailure]:
    """Return the failures, in their order."""
    found: list[ModuleFailure] = []
    open_: dict[str, ModuleFailure] = {}
    for entry in remarks:
        change = _CHANGE.fullmatch(entry.text) if entry.stream == "supervisor" else None
        if change is None:
            continue
        new, failure = change["new"], open_.get(entry.module)
        if new in FAILURES:
            reason = _AGAIN.sub("", change["reason"])
            if failure is None:
                failure = open_[entry.module] = ModuleFailure(entry.time_s, entry.module, reason)
                found.append(failure)
            elif change["old"] not in FAILURES:
                failure.times += 1
            failure.outcome = new
        elif failure is not None:
            failure.outcome = new
            if new == ChildState.RUNNING:
                failure.recovered_s = entry.time_s
                del open_[entry.module]
    return found
