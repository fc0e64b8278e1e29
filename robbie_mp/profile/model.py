"""What a profile says once it is read, merged and checked: plain frozen data, no YAML and no processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from robbie_mp.module.value_check import Limits
from robbie_mp.profile.problem import Place
from robbie_mp.trace.kinds import Kind

AGES_S = 1e9
"""An upper bound for times, about 30 years: more than any run, and less than what system calls refuse."""
MAX_ENTRIES = 1 << 24
"""An upper bound for tables."""
MAX_BYTES = 1 << 48
"""An upper bound for sizes: a process can address no more."""


def bounded(default: Any, minimum: float, maximum: float, choices: tuple[object, ...] = ()) -> Any:
    """Declare a field with its default and what a profile may set it to."""
    return field(default=default, metadata={"limits": Limits(minimum, maximum, choices)})


class RestartWhen(StrEnum):
    """When a module that ended is started again."""

    ALWAYS = "always"
    ON_FAILURE = "on-failure"
    NEVER = "never"


@dataclass(frozen=True)
class RestartPolicy:
    """How the supervisor treats a module that ended."""

    policy: RestartWhen = RestartWhen.ON_FAILURE
    max_restarts: int = bounded(10, 0, MAX_ENTRIES)
    """More than this many within `within_s` and the module is FAILED."""
    within_s: float = bounded(60.0, 0.1, AGES_S)
    backoff_s: float = bounded(0.01, 0, AGES_S)
    """Wait before the first restart; doubles with each further one."""
    backoff_cap_s: float = bounded(5.0, 0, AGES_S)
    stable_after_s: float = bounded(10.0, 0, AGES_S)
    """Running this long gives the whole budget back and the first backoff again."""
    retry_s: float = bounded(30.0, 0, AGES_S)
    """A FAILED module that is not essential is tried again so often, for ever; 0: it is not."""


@dataclass(frozen=True)
class MemoryLimits:
    """What a module may hold in shared memory."""

    segment_bytes: int = bounded(1 << 20, 4096, MAX_BYTES)
    """Size of its first data segment; a message that needs more gets a segment of its own."""
    limit_bytes: int = bounded(256 << 20, 4096, MAX_BYTES)
    """All its data segments together."""
    process_bytes: int | None = bounded(None, 1 << 26, MAX_BYTES)
    """Its process's whole address space; None: as much as it can get."""
    checkpoint_bytes: int = bounded(64 << 20, 4096, MAX_BYTES)
    """Its largest checkpoint; two are kept."""


@dataclass(frozen=True)
class CheckpointPolicy:
    """Whether a module's checkpoints outlive the run."""

    persist: bool = False
    """Keep them on disk as well, for the next run of the profile."""
    persist_every_s: float = bounded(10.0, 0, AGES_S)
    """The disk is written at most so often, and on an ordered stop."""


@dataclass(frozen=True)
class Scheduling:
    """How the system schedules a process, and what it does before it sleeps."""

    realtime_priority: int = bounded(0, 0, 99)
    """Of SCHED_FIFO: it runs before all ordinary processes; 0: it is an ordinary one."""
    nice: int | None = bounded(None, 0, 19)
    """How far it steps back behind other ordinary processes; None: as far as its class says."""
    cpus: list[int] = field(default_factory=list)
    """Numbers of the processors it may run on; empty: all."""
    compute_threads: int = bounded(1, 0, 1024)
    """With how many threads its numerical libraries compute; 0: as the environment says, or they like."""
    spin_us: float = bounded(0.0, 0, 1e6)
    """It looks for the next message so long before it sleeps: faster, but it keeps a processor busy."""
    wake_latency_us: int | None = bounded(None, 0, 1_000_000)
    """While it lives, processors sleep no deeper than to be awake again within that; None: as they do."""


@dataclass(frozen=True)
class QueueLimits:
    """Bounds of the messages that wait for a module; beyond them the oldest goes and is counted."""

    messages: int = bounded(1000, 1, MAX_ENTRIES)
    bytes: int = bounded(64 << 20, 1, MAX_BYTES)
    in_flight_bytes: int = bounded(16 << 20, 1, MAX_BYTES)
    """What of one publisher may be in its ring and hands besides; one message may be larger."""


@dataclass(frozen=True)
class ModuleSpec:
    """One module of a profile."""

    name: str
    class_path: str
    """As `package.module:Class`."""
    settings: Mapping[str, object] = field(default_factory=dict)
    restart: RestartPolicy = RestartPolicy()
    depends_on: tuple[str, ...] = ()
    """Modules with which it is restarted."""
    essential: bool = False
    """Its FAILED stops the robot."""
    ends_run: bool = False
    """When it ends by itself with exit code 0, the run is over: an ordered stop follows."""
    start_deadline_s: float = bounded(30.0, 0.1, AGES_S)
    handler_deadline_s: float = bounded(10.0, 0, AGES_S)
    """A handler or tick that takes longer hangs, and its process is killed; 0: it may take for ever."""
    stop_grace_s: float = bounded(3.0, 0, AGES_S)
    """From SIGTERM to SIGKILL on an ordered stop."""
    memory: MemoryLimits = MemoryLimits()
    queue: QueueLimits = QueueLimits()
    checkpoint: CheckpointPolicy = CheckpointPolicy()
    scheduling: Scheduling = field(default_factory=Scheduling)
    record: list[Kind] | None = None
    """Kinds of trace entries that are recorded of it; None: those of `trace.record`."""
    folder_of: Mapping[str, Path] = field(default_factory=dict)
    """What a relative path in a setting starts from, for settings where that is not the workspace."""


@dataclass(frozen=True)
class CoreLimits:
    """Sizes of the core's tables; each is a bound of the whole run."""

    handles: int = bounded(16384, 1, MAX_ENTRIES)
    """Messages alive at once."""
    references: int = bounded(65536, 1, MAX_ENTRIES)
    """Messages alive, counted once for each subscription that they wait for or are held by."""
    channels: int = bounded(1024, 1, MAX_ENTRIES)
    """Pairs of message type and topic."""
    subscriptions: int = bounded(1024, 1, MAX_ENTRIES)
    ring_records: int = bounded(1024, 16, 1 << 20, choices=tuple(1 << n for n in range(4, 21)))
    """Records of each outbound ring; a power of two."""
    credits: int = bounded(64, 1, MAX_ENTRIES)
    """Messages that a module may have in its inbound ring."""
    deadline_s: float = bounded(2.0, 0.5, AGES_S)
    """A core that gives no sign of life for so long is killed and restarted."""
    restart: RestartPolicy = RestartPolicy(policy=RestartWhen.ALWAYS, max_restarts=20)
    """As for a module; its FAILED ends the run."""
    scheduling: Scheduling = field(default_factory=Scheduling)


@dataclass(frozen=True)
class SpareInterpreters:
    """Interpreters started ahead, that one which is restarted need not wait for its own to start."""

    count: int = bounded(1, 0, 16)
    imports: list[str] = field(default_factory=list)
    """What they import ahead, besides numpy and Robbie-MP itself."""


@dataclass(frozen=True)
class TraceSettings:
    """What is recorded of what processes say, and bounds of it."""

    record: list[Kind] = field(default_factory=lambda: [Kind.ERROR, Kind.WARNING, Kind.INFO])
    """Of modules. Everything is recorded of the core and the supervisor, until `robbie log --record`."""
    lines_per_s: float = bounded(1000.0, 0, 1e6)
    """Of each stream of a process, and of its log records; and `burst_lines` at once."""
    burst_lines: int = bounded(5000, 1, MAX_ENTRIES)
    line_characters: int = bounded(4096, 80, 1 << 20)
    """A longer line is cut into several."""
    kept_lines: int = bounded(200, 1, MAX_ENTRIES)
    """The last ones of each incarnation, for its crash report."""
    file_bytes: int = bounded(4 << 20, 4096, MAX_BYTES)
    """Each file of JSON lines; every process has `files` of them."""
    files: int = bounded(3, 1, 1000)
    page_bytes: int = bounded(24 << 20, 1 << 16, 1 << 30)
    """Each page of HTML; the run has `pages` of them."""
    pages: int = bounded(2, 1, 1000)
    crash_reports: int = bounded(20, 1, MAX_ENTRIES)
    """The newest ones of each process."""
    waiting_bytes: int = bounded(8 << 20, 1 << 16, 1 << 30)
    """What the disk has not taken yet; beyond this it is dropped."""


@dataclass(frozen=True)
class ToolLimits:
    """What commands that attach to the run, such as `robbie echo`, may take of it."""

    count: int = bounded(4, 0, 64)
    """How many may be attached at once."""
    messages: int = bounded(200, 1, MAX_ENTRIES)
    """How many messages may wait for each; beyond this the oldest goes and is counted."""
    bytes: int = bounded(16 << 20, 1, MAX_BYTES)
    """How much memory of the publishers these may hold."""
    credits: int = bounded(4, 1, 64)
    """Messages that each may have in its inbound ring."""


@dataclass(frozen=True)
class ClockSettings:
    """Whose time the run goes by."""

    source: str | None = None
    """The module that turns the run's clock, by playing a log or stepping a simulation; None: the machine."""
    lockstep: bool = False
    """One message is handled at a time in the whole robot, in order; the source grants each tick."""


@dataclass(frozen=True)
class Profile:
    """A merged and checked profile."""

    name: str
    modules: tuple[ModuleSpec, ...]
    """In start order."""
    config: Mapping[str, object] = field(default_factory=dict)
    """Flat: dotted key to value."""
    core: CoreLimits = CoreLimits()
    spares: SpareInterpreters = SpareInterpreters()
    trace: TraceSettings = field(default_factory=TraceSettings)
    tools: ToolLimits = ToolLimits()
    clock: ClockSettings = ClockSettings()
    description: str = ""
    workspace: Path = Path()
    """The folder that contains profiles/; the root of imports and of relative paths."""
    origins: Mapping[tuple[str, ...], Place] = field(default_factory=dict)
    """Where each key was written, as ("modules", "mapping", "settings", "rate_hz"); none for defaults."""

    def place_of(self, *path: str) -> Place | None:
        """Return where a key was written, or else the nearest one that encloses it."""
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path)
