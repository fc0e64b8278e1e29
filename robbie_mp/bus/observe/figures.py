"""The figures of a run at one moment: counters since its start, and current values."""

import os
from dataclasses import dataclass
from typing import NamedTuple

import psutil

from robbie_mp.bus.observe.connections import Unconnected
from robbie_mp.bus.transport.histogram import Histogram
from robbie_mp.bus.transport.tables import ChannelCounts, SubscriptionCounts

SHARED_MEMORY = "/dev/shm"


@dataclass(frozen=True)
class SubscriptionFigures(SubscriptionCounts):
    """One subscription and its counters."""

    type_name: str
    topic: str
    handling: str
    left: int = 0
    """Those of `dropped` that were waiting when the module was stopped."""
    version: int = 0
    """0: type and topic are shell patterns."""
    is_open: bool = True
    """Whether messages are routed to it; not after its module has stopped for good."""
    is_latch: bool = False
    """Whether it is the core's own, which keeps the newest message of one channel for later subscribers."""
    withheld: int = 0
    """Latched messages that its module no longer gets, because it died twice while it handled them."""
    age_s: float | None = None
    """Since the newest message that its process has taken was published; None: it has taken none."""
    deadline_s: float | None = None
    """Greatest age that the module allows; None: any."""
    latenesses: int = 0
    """How often the newest message was older than that, in this process."""
    greatest_age_s: float = 0.0
    """The greatest age then."""

    @property
    def overflowed(self) -> int:
        """Messages dropped because the queue was full: a problem that you should fix."""
        return self.dropped - self.left


class Total(NamedTuple):
    """A sum over the subscriptions of a module, as all tools show it."""

    name: str
    """The attribute of `SubscriptionFigures`."""
    heading: str
    short: str
    """A short heading."""
    problem: str = ""
    """What it means if it rises; '' if that is no problem."""


TOTALS = (
    Total("replaced", "replaced", "repl"),
    Total("overflowed", "dropped", "drop", "its queue overflowed"),
    Total("left", "left", "left"),
    Total("lost", "lost", "lost", "messages were lost in a crash"),
)


@dataclass(frozen=True)
class WorkHistograms:
    """Durations in the present incarnation of a module."""

    latency: Histogram
    """From the publication of a message to the start of its handling by the subscriber."""
    handler: Histogram
    """Time for one message: to decode it, run its handler, and release it."""
    lateness: Histogram
    """From the moment a tick is due to its start: the jitter of an active module."""
    tick: Histogram
    """Duration of ticks."""


@dataclass(frozen=True)
class ModuleFigures:
    """The figures of one process; counters cover all its incarnations."""

    name: str
    state: int
    """Position of its state in the supervisor's order, counted from 1; 0: never started."""
    pid: int
    incarnation: int
    restarts: int
    started_ns: int
    """Start of this incarnation, monotonic clock."""
    reason: str
    """Why the process is in this state."""
    last_end: str
    """How its last process ended; '' if none has ended."""
    last_end_ns: int
    """When it ended, monotonic clock."""
    cpu_s: float
    rss_bytes: int
    """Memory of the process, including the shared memory that it has touched."""
    shared_bytes: int
    """The part of it that is shared memory, such as other modules' messages."""
    threads: int
    wakeups: int
    """How often the threads of this incarnation have waited, and were woken."""
    published: int
    """Messages handed to the core."""
    refused: int
    """Messages that found no room in memory, ring or tables."""
    handled: int
    ticks: int
    """Ticks of this incarnation."""
    ticks_missed: int
    """Ticks that this incarnation skipped because it was too late for them."""
    ticks_wait: bool
    """Whether its ticks wait for something, so that it is no trouble if some are missed."""
    waiting: int
    """Messages in its inbound queue."""
    waiting_peak: int
    waiting_bytes: int
    queue_messages: int
    """Limit of its inbound queue; 0: it has none."""
    queue_bytes: int
    outbound_waiting: int
    """Records in its outbound ring that the core has not read yet."""
    outbound_records: int
    """Capacity of its outbound ring."""
    pinned: int
    """Messages that it has handled but still refers to."""
    pinned_bytes: int
    copied: int
    """Messages that it received as copies, because it pins too much of their publishers' memory."""
    ill_formed: int
    """Ill-formed messages that no handler got, or that it did not let in from outside."""
    outstanding: int
    """Messages it published that a subscriber still waits for or holds."""
    outstanding_bytes: int
    segment_bytes: int
    """Size of its data segments."""
    memory_bytes: int
    """Limit of the size of its data segments."""
    status: str
    """For a module that has ended: its last value."""
    states: str
    """The states of its state machines."""
    health: str
    """Why it is DEGRADED; '' if it is OK."""
    activity: str
    handler: str
    """The handler that is running; '' if none."""
    busy_since_ns: int
    """When it started its present activity, monotonic clock; 0 while it is idle."""
    hot_path: str
    """The language of its hot path: C, or PYTHON; '' if it has not said."""
    work: WorkHistograms | None
    """None while it has no process, and for the core."""
    subscriptions: tuple[SubscriptionFigures, ...]
    publishes: tuple[tuple[str, int, str], ...]
    """Type, version and topic of the channels that it has declared."""
    unconnected: tuple[Unconnected, ...] = ()
    """Its subscriptions for which nobody has published, 10 s after its start."""
    renamed: tuple[tuple[str, str], ...] = ()
    """The module's own name and the name in the run of each topic that the profile renamed."""

    def total(self, column: str) -> int:
        """Sum of a column over the subscriptions."""
        return sum(getattr(entry, column) for entry in self.subscriptions)


@dataclass(frozen=True, kw_only=True)
class ChannelFigures(ChannelCounts):
    """The figures of one channel: the messages of one type and version on one topic."""

    type_name: str
    version: int
    topic: str
    publishers: tuple[str, ...] = ()
    """Modules that have ever declared that they publish on it, also those that have ended."""


@dataclass(frozen=True)
class CoreFigures:
    """The core's figures of itself."""

    routed: int
    wakeups: int
    faults: int
    """How often a module has violated the protocol."""
    heartbeat_ns: int
    """Time of its last sign of life, monotonic clock."""
    handles: int
    """Messages in flight."""
    handles_limit: int
    references: int
    """Pairs of a message in flight and a subscription that it goes to."""
    references_limit: int
    latched_not_given: int = 0
    """Latched messages that new subscribers did not get, because no reference was free."""


@dataclass(frozen=True)
class SegmentFigures:
    """One piece of shared memory."""

    name: str
    kind: str
    """board, core, out, in, data or checkpoint."""
    module: str
    """Name of the owner; '' for a segment of the whole run."""
    bytes: int


@dataclass(frozen=True)
class MachineReading:
    """The figures of the machine at one moment."""

    cpu_busy_s: tuple[float, ...]
    """Time used on each processor since the machine started."""
    load: tuple[float, float, float]
    """Mean number of processes that ran or were ready to run, over the last 1, 5 and 15 minutes."""
    memory_available_bytes: int
    memory_total_bytes: int
    shared_memory_used_bytes: int
    """Used bytes of /dev/shm, by all processes."""
    shared_memory_total_bytes: int

    @classmethod
    def now(cls) -> "MachineReading":
        """Read the machine's figures now."""
        memory = psutil.virtual_memory()
        shared = os.statvfs(SHARED_MEMORY)
        return cls(
            cpu_busy_s=tuple(_busy_s(times) for times in psutil.cpu_times(percpu=True)),
            load=os.getloadavg(),
            memory_available_bytes=memory.available,
            memory_total_bytes=memory.total,
            shared_memory_used_bytes=(shared.f_blocks - shared.f_bfree) * shared.f_frsize,
            shared_memory_total_bytes=shared.f_blocks * shared.f_frsize,
        )


@dataclass(frozen=True)
class RunReading:
    """All figures of a run at one moment."""

    at_ns: int
    """Monotonic clock."""
    wall_time_s: float
    """Unix time."""
    core: CoreFigures
    modules: tuple[ModuleFigures, ...]
    """All processes in start order: the supervisor is first, the core last."""
    channels: tuple[ChannelFigures, ...]
    segments: tuple[SegmentFigures, ...]
    machine: MachineReading
    messages_flow: bool = True
    """Whether every module has started or ended; until then, modules that are ready wait for the others."""

    def module(self, name: str) -> ModuleFigures | None:
        """Return the figures of a module; None if there is no such module."""
        return next((module for module in self.modules if module.name == name), None)


def _busy_s(times: "psutil._ntuples.scputimes") -> float:
    # `user` already includes the time of guests.
    return float(times.user + times.nice + times.system + times.irq + times.softirq + times.steal)
