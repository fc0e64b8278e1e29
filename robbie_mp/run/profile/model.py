"""The content of a profile after it is read, merged and checked: frozen data, no YAML and no processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from strenum import StrEnum

from robbie_mp.base.linux.priority import MAX_SLICE_MS, MIN_SLICE_MS
from robbie_mp.base.problem import SourcePlace
from robbie_mp.module.clock import AGES_S
from robbie_mp.module.value_check import ValueLimits
from robbie_mp.run.trace.kinds import Kind

MAX_ENTRIES = 1 << 24
"""Upper limit of table sizes."""
MAX_BYTES = 1 << 48
"""Upper limit of sizes in bytes: a process cannot address more."""


def bounded(default: Any, minimum: float, maximum: float, choices: tuple[object, ...] = ()) -> Any:
    """Declare a field with its default and the limits for profiles."""
    return field(default=default, metadata={"limits": ValueLimits(minimum, maximum, choices)})


class RestartWhen(StrEnum):
    """When the supervisor restarts a module that ended."""

    ALWAYS = "always"
    ON_FAILURE = "on-failure"
    NEVER = "never"


@dataclass(frozen=True)
class RestartPolicy:
    """How the supervisor restarts a module that ended."""

    policy: RestartWhen = RestartWhen.ON_FAILURE
    max_restarts: int = bounded(10, 0, MAX_ENTRIES)
    """With more restarts than this within `within_s` the module is FAILED."""
    within_s: float = bounded(60.0, 0.1, AGES_S)
    backoff_s: float = bounded(0.01, 0, AGES_S)
    """Wait before the first restart; it doubles with each further restart."""
    backoff_cap_s: float = bounded(5.0, 0, AGES_S)
    stable_after_s: float = bounded(10.0, 0, AGES_S)
    """After running this long, the module has its full budget and the first backoff again."""
    retry_s: float = bounded(30.0, 0, AGES_S)
    """Time between further attempts to start a FAILED, inessential module; 0: no further attempts."""


@dataclass(frozen=True)
class MemoryLimits:
    """Limits of a module's memory."""

    segment_bytes: int = bounded(1 << 20, 4096, MAX_BYTES)
    """Size of its first data segment; a larger message gets its own segment."""
    limit_bytes: int = bounded(256 << 20, 4096, MAX_BYTES)
    """Size of all its data segments together."""
    process_bytes: int | None = bounded(None, 1 << 26, MAX_BYTES)
    """Address space of its process; None: no limit."""
    checkpoint_bytes: int = bounded(64 << 20, 4096, MAX_BYTES)
    """Largest size of a checkpoint; two are kept."""
    history_bytes: int | None = bounded(8 << 20, 1 << 17, 1 << 30)
    """What it has handled, kept for the capsule of a crash; None: nothing. Messages that are larger than a
    sixteenth of it are left out. Its memory is taken as it is needed."""


@dataclass(frozen=True)
class CheckpointPolicy:
    """Whether a module's checkpoints survive the run."""

    persist: bool = False
    """Also keep them on disk, for the next run of the profile."""
    persist_every_s: float = bounded(10.0, 0, AGES_S)
    """Least time between two writes to the disk; an ordered stop also writes."""


@dataclass(frozen=True)
class Scheduling:
    """How the system schedules a process, and how the process waits."""

    realtime_priority: int = bounded(0, 0, 99)
    """SCHED_FIFO priority, which runs before all ordinary processes; 0: an ordinary process."""
    nice: int | None = bounded(None, 0, 19)
    """Nice value among ordinary processes; None: the value of its class."""
    slice_ms: float | None = bounded(None, MIN_SLICE_MS, MAX_SLICE_MS)
    """Time slice: processes that wake up interrupt one with a longer slice; None: the value of its class."""
    cpus: list[int] = field(default_factory=list)
    """Numbers of the processors that it may run on; empty: all."""
    compute_threads: int = bounded(1, 0, 1024)
    """Number of threads of its numerical libraries; 0: as the environment sets it, or their default."""
    spin_us: float = bounded(0.0, 0, 1e6)
    """How long it polls for the next message before it sleeps: faster, but it keeps a processor busy."""
    wake_latency_us: int | None = bounded(None, 0, 1_000_000)
    """While it runs, processors must wake up from idle states within this time; None: no limit."""


@dataclass(frozen=True)
class QueueLimits:
    """Limits of the messages that wait for a module; beyond them the oldest is dropped and counted."""

    messages: int = bounded(1000, 1, MAX_ENTRIES)
    bytes: int = bounded(64 << 20, 1, MAX_BYTES)
    in_flight_bytes: int = bounded(16 << 20, 1, MAX_BYTES)
    """Bytes of one publisher that may also be in its ring or held by it; a single message may be larger."""


HANDLER_DEADLINE_S = 10.0
"""The deadline of a module for which neither its profile nor its class sets one."""


@dataclass(frozen=True)
class ModuleSpec:
    """One module of a profile."""

    name: str
    class_path: str
    """Written as `package.module:Class`."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    """New names of topics by the names that the class uses."""
    namespace: str = ""
    """Comes before the names of all its topics, with a slash between; '' for none."""
    restart: RestartPolicy = RestartPolicy()
    depends_on: tuple[str, ...] = ()
    """Names of modules; when one of them is restarted, so is this module."""
    essential: bool = False
    """The robot stops when this module is FAILED."""
    ends_run: bool = False
    """The run ends with an ordered stop when this module ends with exit code 0."""
    optional: bool = False
    """The run starts without this module if its code cannot be imported."""
    start_deadline_s: float = bounded(30.0, 0.1, AGES_S)
    handler_deadline_s: float | None = bounded(None, 0, AGES_S)
    """A handler or tick that takes longer counts as hung, and its process is killed; 0: no limit; None: the
    value of its class, or else `HANDLER_DEADLINE_S`."""
    stop_grace_s: float = bounded(3.0, 0, AGES_S)
    """Time between SIGTERM and SIGKILL on an ordered stop."""
    memory: MemoryLimits = MemoryLimits()
    queue: QueueLimits = QueueLimits()
    checkpoint: CheckpointPolicy = CheckpointPolicy()
    scheduling: Scheduling = field(default_factory=Scheduling)
    record: list[Kind] | None = None
    """Kinds of trace entries that are recorded for it; None: those of `trace.record`."""
    folder_of: Mapping[str, Path] = field(default_factory=dict)
    """Folder that a relative path in a setting starts from, where it is not the workspace."""
    code: str = ""
    """See `Variant`: no profile has it."""


@dataclass(frozen=True)
class CoreLimits:
    """Sizes of the core's tables; each is a limit for the whole run."""

    handles: int = bounded(16384, 1, MAX_ENTRIES)
    """Messages that exist at once."""
    references: int = bounded(65536, 1, MAX_ENTRIES)
    """Messages that exist at once, counted once for each subscription that waits for or holds them."""
    channels: int = bounded(1024, 1, MAX_ENTRIES)
    """Pairs of message type and topic."""
    subscriptions: int = bounded(1024, 1, MAX_ENTRIES)
    latched_messages: int = bounded(1024, 1, MAX_ENTRIES)
    """Newest messages of latched channels that the core keeps for later subscribers."""
    latched_bytes: int = bounded(256 << 20, 1, MAX_BYTES)
    """Their size in total. Beyond either limit, the oldest is dropped; one message may be larger."""
    ring_records: int = bounded(1024, 16, 1 << 20, choices=tuple(1 << n for n in range(4, 21)))
    """Records of each outbound ring; a power of two."""
    credits: int = bounded(64, 1, MAX_ENTRIES)
    """Messages that a module may have in its inbound ring."""
    deadline_s: float = bounded(2.0, 0.5, AGES_S)
    """A core that gives no sign of life for this long is killed and restarted."""
    restart: RestartPolicy = RestartPolicy(policy=RestartWhen.ALWAYS, max_restarts=20)
    """As for a module; the run ends when the core is FAILED."""
    scheduling: Scheduling = field(default_factory=Scheduling)


@dataclass(frozen=True)
class SpareInterpreters:
    """Interpreters started ahead, so that a restarted module need not wait for one to start."""

    count: int = bounded(1, 0, 16)
    imports: list[str] = field(default_factory=list)
    """Modules that they import ahead, besides numpy and Robbie-MP itself."""


@dataclass(frozen=True)
class TraceSettings:
    """Which output of processes is recorded, and its limits."""

    record: list[Kind] = field(default_factory=lambda: [Kind.ERROR, Kind.WARNING, Kind.INFO])
    """For modules. For the core and the supervisor everything is recorded, until `robbie log --record`."""
    lines_per_s: float = bounded(1000.0, 0, 1e6)
    """For each stream of a process, and for its log records; `burst_lines` may come at once."""
    burst_lines: int = bounded(5000, 1, MAX_ENTRIES)
    line_characters: int = bounded(4096, 80, 1 << 20)
    """A longer line is split."""
    kept_lines: int = bounded(200, 1, MAX_ENTRIES)
    """The last lines of each incarnation, kept for its crash report."""
    file_bytes: int = bounded(4 << 20, 4096, MAX_BYTES)
    """Size of each file of JSON lines; every process has `files` of them."""
    files: int = bounded(3, 1, 1000)
    page_bytes: int = bounded(24 << 20, 1 << 16, 1 << 30)
    """Size of each HTML page; the run has `pages` of them."""
    pages: int = bounded(2, 1, 1000)
    crash_reports: int = bounded(20, 1, MAX_ENTRIES)
    """The newest lines of each process."""
    capsules: int = bounded(5, 0, 1000)
    """The newest capsules of each module; 0: none are written."""
    waiting_bytes: int = bounded(8 << 20, 1 << 16, 1 << 30)
    """Bytes that wait to be written to the disk; beyond this they are dropped."""
    kept_runs: int = bounded(100, 0, MAX_ENTRIES)
    """Results of earlier runs that stay when a run starts; 0: all. Those with recordings always stay."""


@dataclass(frozen=True)
class ToolLimits:
    """Limits for commands that attach to the run, such as `robbie echo`."""

    count: int = bounded(4, 0, 64)
    """Number of tools that may be attached at once."""
    messages: int = bounded(200, 1, MAX_ENTRIES)
    """Messages that may wait for each tool; beyond this the oldest is dropped and counted."""
    bytes: int = bounded(16 << 20, 1, MAX_BYTES)
    """Bytes of the publishers' memory that these messages may hold."""
    credits: int = bounded(4, 1, 64)
    """Messages that each tool may have in its inbound ring."""


MEASURED = "measured"
HANDLER_TIMES = "handler_times"
"""The folder in a run's output with the time of each handler, in a file for each module."""


FOLLOWED = {"ros": "robbie_mp.connect.ros2.module:Ros2Bridge"}
"""The classes of the bridges to those whose time a run can follow."""


@dataclass(frozen=True)
class ClockSettings:
    """Which clock the run follows."""

    source: str | None = None
    """The module that turns the run's clock (plays a log, steps a simulation); None: the machine's clock."""
    follow: str = ""
    """Whose time the run follows, one of FOLLOWED; its bridge is the source. "": nobody's."""
    lockstep: bool = False
    """The whole robot handles one message at a time, in order; the source grants each tick."""
    charge: str = ""
    """In lockstep, whether a module is busy by the run's clock while it handles a message: '' no; MEASURED as
    long as the handler took; or the folder with the times of an earlier run."""


BLACK_BOX = "black_box"
"""Name of the module that `robbie run` adds to every robot, and of the key with its settings."""
CLIPS_BYTES = 2 << 30
"""Disk space for its clips, if the profile says nothing else."""


@dataclass(frozen=True)
class Profile:
    """A merged and checked profile."""

    name: str
    modules: tuple[ModuleSpec, ...]
    """In start order."""
    core: CoreLimits = CoreLimits()
    spares: SpareInterpreters = SpareInterpreters()
    trace: TraceSettings = field(default_factory=TraceSettings)
    tools: ToolLimits = ToolLimits()
    clock: ClockSettings = ClockSettings()
    black_box: ModuleSpec | None = None
    """The module to add to the robot, which is not yet in `modules`; None: there is none to add."""
    description: str = ""
    variables: Mapping[str, Any] = field(default_factory=dict)
    """Their values in this run, which have been inserted everywhere."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Why modules are left out, by name: their condition, or `--without`."""
    workspace: Path = Path()
    """The folder that contains profiles/; imports and relative paths start from it."""
    origins: Mapping[tuple[str, ...], SourcePlace] = field(default_factory=dict)
    """Place of each written key, such as ("modules", "mapping", "settings", "rate_hz"); none for defaults."""
    removals: Mapping[tuple[str, ...], SourcePlace] = field(default_factory=dict)
    """Place of each key that a null removes although no profile sets it."""

    def with_black_box(self) -> "Profile":
        """Return the profile of the robot with its black box, which starts first and so stops last."""
        if self.black_box is None or not self.modules:
            return self
        return replace(self, modules=(self.black_box, *self.modules), black_box=None)

    def removed_settings(self, module: str) -> list[str]:
        """Return the settings of a module that a null removes although no profile sets them."""
        return [path[-1] for path in self.removals if path[:-1] == ("modules", module, "settings")]

    def place_of(self, *path: str) -> SourcePlace | None:
        """Return where a key was written, or else where the nearest enclosing key was."""
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path)
