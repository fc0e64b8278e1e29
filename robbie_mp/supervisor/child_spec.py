"""What the supervisor must know of a child to run it."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Self

from robbie_mp.errors import RobbieError
from robbie_mp.profile.model import CoreLimits, ModuleSpec, RestartPolicy, Scheduling
from robbie_mp.trace.kinds import ALL_KINDS, Kind

SPARE_COMPUTE_THREADS = Scheduling().compute_threads
"""A spare has loaded numpy already; a child with another number needs an interpreter of its own."""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


class InvalidChild(RobbieError, ValueError):
    """A child cannot be described so.

    Example scenarios:
      - its name holds a slash, but names a log file
      - two children have the same name
    """


class ChildKind(StrEnum):
    """Which part a child plays."""

    CORE = "core"
    """Is ready before any module starts and stops last; its FAILED ends the run."""
    MODULE = "module"


@dataclass(frozen=True)
class ChildSpec:
    """A command and how its ends are treated; see ModuleSpec for the fields they share."""

    name: str
    argv: tuple[str, ...]
    environment: Mapping[str, str]
    """All of it; the supervisor adds one variable to know the child's descendants by."""
    kind: ChildKind = ChildKind.MODULE
    folder: Path | None = None
    """Working directory; None: the supervisor's."""
    restart: RestartPolicy = field(default_factory=RestartPolicy)
    depends_on: tuple[str, ...] = ()
    essential: bool = False
    ends_run: bool = False
    start_deadline_s: float = 30.0
    stop_grace_s: float = 3.0
    handler_deadline_s: float = 0.0
    """How long it may do one and the same thing; 0: for ever."""
    record: Collection[Kind] = ALL_KINDS
    """Which kinds of entries of the trace are recorded of it."""
    may_be_warm: bool = False
    """Whether a spare interpreter does the same as the command, so that it may take its place."""

    @property
    def is_needed(self) -> bool:
        """Whether the run stops when it is FAILED."""
        return self.essential or self.ends_run or self.kind is ChildKind.CORE

    def __post_init__(self) -> None:
        """Check the name.

        Raises:
            InvalidChild: it cannot name a file.
        """
        if not NAME.fullmatch(self.name):
            raise InvalidChild(f"child name {self.name!r}: use letters, digits and _ . - only")

    @classmethod
    def of_module(
        cls,
        module: ModuleSpec,
        argv: tuple[str, ...],
        environment: Mapping[str, str],
        record: Collection[Kind],
    ) -> Self:
        """Describe the child that runs a profile's module; `record` holds if the module says nothing else."""
        return cls(
            name=module.name,
            argv=argv,
            environment=environment,
            restart=module.restart,
            depends_on=module.depends_on,
            essential=module.essential,
            ends_run=module.ends_run,
            start_deadline_s=module.start_deadline_s,
            stop_grace_s=module.stop_grace_s,
            handler_deadline_s=module.handler_deadline_s,
            record=record if module.record is None else module.record,
            may_be_warm=module.scheduling.compute_threads == SPARE_COMPUTE_THREADS,
        )

    @classmethod
    def of_core(cls, limits: CoreLimits, argv: tuple[str, ...], environment: Mapping[str, str]) -> Self:
        """Describe the child that routes the messages; it takes over from its dead predecessor."""
        return cls(
            name="core",
            argv=argv,
            environment=environment,
            kind=ChildKind.CORE,
            restart=limits.restart,
            essential=True,
            handler_deadline_s=limits.deadline_s,
            may_be_warm=limits.scheduling.compute_threads == SPARE_COMPUTE_THREADS,
        )
