"""The description of a child: all the supervisor needs to run it."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from strenum import StrEnum
from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.profile.model import CoreLimits, ModuleSpec, Scheduling
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
    """A command, and what to do when it ends."""

    module: ModuleSpec
    """What the profile says about it; for the core, what `core` of the profile says."""
    argv: tuple[str, ...]
    environment: Mapping[str, str]
    """The whole environment; the supervisor adds one variable that marks the child's descendants."""
    kind: ChildKind = ChildKind.MODULE
    folder: Path | None = None
    """Working directory; None: the supervisor's."""
    record: Collection[Kind] = ALL_KINDS
    """The kinds of trace entries recorded for this child."""
    may_be_warm: bool = False
    """Whether a spare interpreter can take the place of the command."""

    @property
    def name(self) -> str:
        """Name of the child and of its module."""
        return self.module.name

    @property
    def is_needed(self) -> bool:
        """Whether the run stops when this child is FAILED."""
        return self.module.essential or self.module.ends_run or self.kind is ChildKind.CORE

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
            module,
            argv,
            environment,
            record=record if module.record is None else module.record,
            may_be_warm=_may_be_warm(module.scheduling),
        )

    @classmethod
    def of_core(cls, limits: CoreLimits, argv: tuple[str, ...], environment: Mapping[str, str]) -> Self:
        """Describe the core, the child that routes the messages."""
        core = ModuleSpec("core", "", restart=limits.restart, handler_deadline_s=limits.deadline_s)
        return cls(core, argv, environment, ChildKind.CORE, may_be_warm=_may_be_warm(limits.scheduling))


def _may_be_warm(scheduling: Scheduling) -> bool:
    return scheduling.compute_threads == SPARE_COMPUTE_THREADS
