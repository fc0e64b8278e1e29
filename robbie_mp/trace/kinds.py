"""The four kinds of entries, as the tracer of the Robbie architecture had them."""

import logging
from collections.abc import Collection
from enum import StrEnum


class Kind(StrEnum):
    """How much an entry matters."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"
    SYSTEM = "system"
    """Very detailed: every change of a child's state, and what modules log with `debug`."""


ALL_KINDS = frozenset(Kind)
KIND_OF_STREAM = {"stdout": Kind.INFO, "stderr": Kind.WARNING}
"""Of what is printed: libraries in C complain on standard error, and say there what they do as well."""
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
    """Return the lowest level of log records that is worth making when these kinds are recorded."""
    return next((level for kind, level in _LOWEST_LEVELS if kind in kinds), logging.CRITICAL + 1)
