"""The run plan: a JSON file in the run's folder that the supervisor writes before it starts any child."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import msgspec
from typing_extensions import Self

from robbie_mp.base.linux.private_files import write_private
from robbie_mp.base.version import installed_version
from robbie_mp.bus.transport.board import TOOL_PREFIX
from robbie_mp.bus.transport.layout import MAX_OUTSTANDING
from robbie_mp.bus.transport.run_memory import RingSizes
from robbie_mp.run.learnt_types import learnt_types
from robbie_mp.run.profile.model import (
    ClockSettings,
    CoreLimits,
    ModuleSpec,
    Profile,
    QueueLimits,
    ToolLimits,
)

PLAN_FILE = "plan.json"
SUPERVISOR_MEMORY_BYTES = 1 << 20
"""Limit of the shared memory for the supervisor's messages."""
TOOL_MEMORY_BYTES = 64 << 20
"""Limit of the shared memory for a tool's messages."""
CORE = "core"
"""Name of the core's process."""


@dataclass(frozen=True)
class RunPlan:
    """A run, as its processes know it. Module number i has slot i + 1; slot 0 is the supervisor's."""

    run_id: str
    profile_name: str
    workspace: str
    output_directory: str
    supervisor_pid: int
    core: CoreLimits
    modules: tuple[ModuleSpec, ...]
    spare_imports: list[str]
    """Packages that a spare interpreter imports in advance."""
    tools: ToolLimits
    clock: ClockSettings
    types: list[tuple[str, int, str, str]]
    """The robot's own message types that its modules declare on import, and those that it has learnt since.
    Each is the content of a `TypeDescription` as a plain tuple, so that the core and spares need not import
    `messages`."""
    reloads: bool = False
    """Whether modules are restarted when their files are saved, so that they report which these are."""
    version: str = ""
    """Of Robbie-MP; it takes long to find out, and each process that starts would need it."""

    @classmethod
    def of_profile(
        cls,
        profile: Profile,
        run_id: str,
        workspace: Path,
        output_directory: Path,
        supervisor_pid: int,
        types: Iterable[tuple[str, int, str, str]] = (),
        *,
        reloads: bool = False,
    ) -> Self:
        """Plan a run of a profile."""
        return cls(
            run_id=run_id,
            version=installed_version(),
            profile_name=profile.name,
            workspace=str(workspace),
            output_directory=str(output_directory),
            supervisor_pid=supervisor_pid,
            core=profile.core,
            modules=profile.modules,
            spare_imports=profile.spares.imports,
            tools=profile.tools,
            clock=profile.clock,
            types=list(types),
            reloads=reloads,
        )

    @property
    def sizes(self) -> RingSizes:
        """Capacities of the rings."""
        return RingSizes(self.core.ring_records, self.core.credits)

    @property
    def tool_sizes(self) -> RingSizes:
        """Capacities of the rings of an attached tool."""
        return RingSizes(self.core.ring_records, self.tools.credits)

    @property
    def tool_queue(self) -> QueueLimits:
        """Bounds of the queue of an attached tool.

        All tools together hold at most a quarter of the rows of the core's tables, of the messages that a
        module may have in flight, and, except for one message each, of any module's memory.
        """
        shares = 4 * max(self.tools.count, 1)
        rows = min(self.core.handles, self.core.references, MAX_OUTSTANDING) // shares
        memory = min((module.memory.limit_bytes for module in self.modules), default=self.tools.bytes)
        return QueueLimits(
            max(1, min(self.tools.messages, rows - self.tools.credits)),
            max(1, min(self.tools.bytes, memory // shares)),
        )

    @property
    def tool_names(self) -> list[str]:
        """Names of the tools' rows on the board; no module can have such a name."""
        return [f"{TOOL_PREFIX}{number}" for number in range(1, self.tools.count + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the board's rows, in order."""
        return ["supervisor", *(module.name for module in self.modules), *self.tool_names, CORE]

    def save(self, run_directory: Path) -> None:
        """Write the plan for the children."""
        plain = msgspec.to_builtins(self, enc_hook=str)
        write_private(run_directory / PLAN_FILE, json.dumps(plain, indent=1))

    @classmethod
    def load(cls, run_directory: Path) -> Self:
        """Read the plan that the supervisor wrote, and what the run has learnt since."""
        plain = json.loads((run_directory / PLAN_FILE).read_text())
        plain["types"] += learnt_types(run_directory)
        return msgspec.convert(plain, cls, dec_hook=lambda kind, value: kind(value))
