"""The resources that a run holds: names in shared memory, descriptors, mappings, and rows of tables."""

import contextlib
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.tables import CoreTables


@dataclass(frozen=True)
class Traces:
    """The resources at one moment.

    Attributes:
        names: entries of /dev/shm that belong to the run.
        descriptors: the other open files of each process, by its name, without the run's segments.
        mappings: the run's segments that each process maps or has open, by its name. They have the names
            that `/proc` gives them.
    """

    names: frozenset[str]
    descriptors: Mapping[str, tuple[str, ...]]
    mappings: Mapping[str, frozenset[str]]

    @classmethod
    def of(cls, run_id: str, pids: Mapping[str, int]) -> "Traces":
        """Read the resources of a run's processes."""
        of_run = names.folder(run_id)
        opened = {name: _opened(pid) for name, pid in pids.items()}
        return cls(
            frozenset(f"{of_run}/{path.name}" for path in (SHARED_MEMORY / of_run).iterdir()),
            {
                name: tuple(sorted(path for path in paths if of_run not in path))
                for name, paths in opened.items()
            },
            {
                name: frozenset(path for path in [*_mapped(pid), *opened[name]] if of_run in path)
                for name, pid in pids.items()
            },
        )


def _opened(pid: int) -> list[str]:
    found = []
    for entry in os.scandir(f"/proc/{pid}/fd"):
        with contextlib.suppress(FileNotFoundError):
            found.append(os.readlink(entry.path))
    return found


def _mapped(pid: int) -> list[str]:
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return [line.split(maxsplit=5)[5] for line in lines if str(SHARED_MEMORY) in line]


def stale_names(traces: Traces, run_id: str, modules: Mapping[str, ModuleFigures]) -> list[str]:
    """Return the names that no living process of a run at rest needs."""
    slots = {slot: module.incarnation for slot, module in enumerate(modules.values(), start=1)}
    slots[0] = 1  # the supervisor
    kept = {names.home(run_id), names.board(run_id), names.clock(run_id)}
    kept |= {names.core(run_id), names.core_wakeup(run_id)}
    data = []
    for slot, incarnation in slots.items():
        kept |= {names.outbound(run_id, slot, incarnation), names.inbound(run_id, slot, incarnation)}
        kept.add(names.wakeup(run_id, slot, incarnation))
        kept.add(names.history(run_id, slot, incarnation))
        kept |= {names.checkpoint(run_id, slot, number) for number in (0, 1)}
        data.append(names.data_prefix(run_id, slot, incarnation))
    return sorted(name for name in traces.names if name not in kept and not name.startswith(tuple(data)))


def violations(before: Traces, after: Traces, run_id: str, modules: Mapping[str, ModuleFigures]) -> list[str]:
    """Compare a run at rest with itself at the beginning."""
    found = [
        f"{SHARED_MEMORY}/{name} belongs to no living process" for name in stale_names(after, run_id, modules)
    ]
    for name, opened in after.descriptors.items():
        extra = Counter(map(_kind, opened)) - Counter(map(_kind, before.descriptors[name]))
        # Each process name has a log file, which is opened with the process's first line and stays open.
        logs = {what: 1 for what in extra if what.endswith(".jsonl")}
        extra -= Counter(logs)
        if extra:
            found.append(f"{name} has more descriptors open than at the beginning: {dict(extra)}")
    there = after.names | {names.folder(run_id)}  # which the supervisor holds open, and locked
    for name, mappings in after.mappings.items():
        for mapping in sorted(mappings):
            if mapping.removeprefix(f"{SHARED_MEMORY}/") not in there:
                found.append(f"{name} still maps or has open {mapping}, whose name is gone")
    return found


def rows_used(run_id: str) -> int:
    """Return the numbers of messages and references that the core's tables still hold."""
    segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
    try:
        words, tables = segment.words, CoreTables.attach(segment.words)
        sizes = tables.sizes
        handles = (words[tables.handle(row) + layout.HANDLE_SEQUENCE] for row in range(sizes.handles))
        claims = (words[tables.reference(row) + layout.REFERENCE_STATE] for row in range(sizes.references))
        return sum(map(bool, handles)) + sum(map(bool, claims))
    finally:
        segment.close()


def _kind(path: str) -> str:
    """Return what a descriptor refers to, without the number that distinguishes it from others."""
    return path.partition(":")[0]


def kinds(traces: Traces) -> dict[str, int]:
    """Count names by kind: board, core, out, in, wakeup, data, checkpoint."""
    return dict(Counter(name.partition("/")[2].split("-")[0] for name in sorted(traces.names)))
