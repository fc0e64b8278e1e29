"""What a profile says once it is read, merged and checked: plain frozen data, no YAML and no processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class RestartWhen(StrEnum):
    """When a module that ended is started again."""

    ALWAYS = "always"
    ON_FAILURE = "on-failure"
    NEVER = "never"


@dataclass(frozen=True)
class RestartPolicy:
    """How the supervisor treats a module that ended."""

    policy: RestartWhen = RestartWhen.ON_FAILURE
    max_restarts: int = 5
    """More than this many within `within_s` and the module is FAILED."""
    within_s: float = 60.0
    backoff_s: float = 0.05
    """Wait before the first restart; doubles with each further one."""
    backoff_cap_s: float = 5.0
    stable_after_s: float = 10.0
    """Running this long gives the whole budget back and the first backoff again."""


@dataclass(frozen=True)
class MemoryLimits:
    """What a module may hold in shared memory."""

    segment_bytes: int = 1 << 20
    """Size of its first data segment; a message that needs more gets a segment of its own."""
    limit_bytes: int = 256 << 20
    """All its data segments together."""


@dataclass(frozen=True)
class QueueLimits:
    """Bounds of the messages that wait for a module; beyond them the oldest goes and is counted."""

    messages: int = 1000
    bytes: int = 64 << 20


@dataclass(frozen=True)
class ModuleSpec:
    """One module of a profile."""

    name: str
    class_path: str
    """As `package.module:Class`."""
    settings: Mapping[str, object] = field(default_factory=dict)
    restart: RestartPolicy = RestartPolicy()
    essential: bool = False
    """Its FAILED stops the robot."""
    ends_run: bool = False
    """When it ends by itself with exit code 0, the run is over: an ordered stop follows."""
    start_deadline_s: float = 30.0
    stop_grace_s: float = 3.0
    """From SIGTERM to SIGKILL on an ordered stop."""
    memory: MemoryLimits = MemoryLimits()
    queue: QueueLimits = QueueLimits()


@dataclass(frozen=True)
class CoreLimits:
    """Sizes of the core's tables; each is a bound of the whole run."""

    handles: int = 16384
    """Messages alive at once."""
    references: int = 65536
    """Messages alive, counted once for each subscription that they wait for or are held by."""
    channels: int = 1024
    """Pairs of message type and topic."""
    subscriptions: int = 1024
    ring_records: int = 1024
    """Records of each outbound ring; a power of two."""
    credits: int = 64
    """Messages that a module may have in its inbound ring."""


@dataclass(frozen=True)
class Profile:
    """A merged and checked profile."""

    name: str
    modules: tuple[ModuleSpec, ...]
    """In start order."""
    config: Mapping[str, object] = field(default_factory=dict)
    """Flat: dotted key to value."""
    core: CoreLimits = CoreLimits()
