"""The four kinds of entries, as the Robbie architecture's tracer had them, and which of them are recorded.

Which kinds are recorded of each child is kept in a file in the run's folder. A child reads it when it starts
and at each SIGURG, so that it does not make log records that nobody records. SIGURG is ignored by default, so
it may be sent to any child at any time.
"""

import json
import logging
import signal
from collections.abc import Collection, Mapping
from pathlib import Path

from strenum import StrEnum

from robbie_mp.base.linux.private_files import write_private


class Kind(StrEnum):
    """How important an entry is."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"
    SYSTEM = "system"
    """Very detailed: every change of a child's state, and what modules log with `debug`."""


ALL_KINDS = frozenset(Kind)
KIND_OF_STREAM = {"stdout": Kind.INFO, "stderr": Kind.WARNING}
"""Kinds of printed lines. C libraries print warnings as well as progress on standard error."""
_LOWEST_LEVELS = (
    (Kind.SYSTEM, logging.DEBUG),
    (Kind.INFO, logging.INFO),
    (Kind.WARNING, logging.WARNING),
    (Kind.ERROR, logging.ERROR),
)


def kind_of_level(level: int) -> Kind:
    """Return the kind of a log record by its level."""
    if level >= logging.ERROR:
        return Kind.ERROR
    if level >= logging.WARNING:
        return Kind.WARNING
    return Kind.INFO if level >= logging.INFO else Kind.SYSTEM


def lowest_level(kinds: Collection[Kind]) -> int:
    """Return the lowest level of log records to make when these kinds are recorded."""
    return next((level for kind, level in _LOWEST_LEVELS if kind in kinds), logging.CRITICAL + 1)


RECORDED_FILE = "recorded_kinds.json"


def write_recorded(run_folder: Path, recorded: Mapping[str, Collection[Kind]]) -> None:
    """Write which kinds are recorded of each child and of the supervisor's remarks."""
    write_private(run_folder / RECORDED_FILE, recorded_as_json(recorded))


def recorded_as_json(recorded: Mapping[str, Collection[Kind]]) -> bytes:
    """Return the content of the file."""
    plain = {name: [kind for kind in Kind if kind in kinds] for name, kinds in recorded.items()}
    return json.dumps(plain).encode()


def read_recorded(run_folder: Path) -> dict[str, list[Kind]]:
    """Return the kinds recorded of each process; {} if the file is missing."""
    try:
        told = json.loads((run_folder / RECORDED_FILE).read_text())
        return {name: [Kind(kind) for kind in kinds] for name, kinds in told.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def read_level(run_folder: Path, name: str) -> int:
    """Return the lowest level of log records that a child should make."""
    kinds = read_recorded(run_folder).get(name)
    return logging.INFO if kinds is None else lowest_level(kinds)


def follow_level(run_folder: Path, name: str) -> None:
    """Set this process's log level, now and whenever the recorded kinds change."""
    root = logging.getLogger()
    signal.signal(signal.SIGURG, lambda _signal, _frame: root.setLevel(read_level(run_folder, name)))
    root.setLevel(read_level(run_folder, name))
