"""The description of a child: all the supervisor needs to run it."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.profile.model import CoreLimits, ModuleSpec, RestartPolicy, Scheduling
from robbie_mp.run.trace.kinds import ALL_KINDS, Kind

SPARE_COMPUTE_THREADS = Scheduling().compute_threads
"""A spare has already loaded numpy with this setting; a child with another number must be started cold."""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


class InvalidChild(RobbieError, ValueError):
    """The description of a child is invalid.

    Example scenarios:
      - its name contains a slash, but it is also the name of a log file
      - two children have the same name
    """


class ChildKind(StrEnum):
    """The role of a child."""

    CORE = "core"
    """Ready before any module starts; stops last. If it is FAILED, the run ends."""
    MODULE = "module"


@dataclass(frozen=True)
class ChildSpec:
    """A command, and what to do when it ends; see ModuleSpec for the fields they share."""

    name: str
    argv: tuple[str, ...]
    environment: Mapping[str, str]
    """The whole environment; the supervisor adds one variable that marks the child's descendants."""
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
    """How long one handler or tick may run; 0: without limit."""
    record: Collection[Kind] = ALL_KINDS
    """The kinds of trace entries recorded for this child."""
    may_be_warm: bool = False
    """Whether a spare interpreter can take the place of the command."""

    @property
    def is_needed(self) -> bool:
        """Whether the run stops when this child is FAILED."""
        return self.essential or self.ends_run or self.kind is ChildKind.CORE

    def __post_init__(self) -> None:
        """Check the name.

        Raises:
            InvalidChild: the name cannot be used as a file name.
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
        """Describe the child that runs a module; `record` is the default if the module sets none."""
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
        """Describe the core, the child that routes the messages."""
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
