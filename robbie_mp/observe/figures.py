"""What is known of a run at one moment: counters since its begin, and what is now."""

from dataclasses import dataclass

from robbie_mp.observe.machine import MachineReading
from robbie_mp.transport.histogram import Histogram


@dataclass(frozen=True)
class SubscriptionFigures:
    """The books of one subscription: routed = delivered + replaced + dropped + lost + waiting."""

    type_name: str
    topic: str
    handling: str
    routed: int
    delivered: int
    replaced: int
    dropped: int
    lost: int
    left: int = 0
    """Of the dropped ones: those that waited when the module was stopped."""
    version: int = 0
    """0: type and topic are shell patterns."""
    is_open: bool = True
    """Whether messages go to it; not after its module has stopped for good."""

    @property
    def waiting(self) -> int:
        """Messages that wait or are being handled."""
        return self.routed - self.delivered - self.replaced - self.dropped - self.lost

    @property
    def overflowed(self) -> int:
        """Messages dropped because the queue was full: what somebody should do something about."""
        return self.dropped - self.left


@dataclass(frozen=True)
class WorkHistograms:
    """How long things took in the present incarnation of a module."""

    latency: Histogram
    """From the publication of a message to the moment its subscriber turns to it."""
    handler: Histogram
    """For one message: decode it, run its handler, give it back."""
    lateness: Histogram
    """From the moment a tick is due to its begin: the jitter of an active module."""
    tick: Histogram
    """Length of ticks."""


@dataclass(frozen=True)
class ModuleFigures:
    """What is known of one process; counters are over all its incarnations."""

    name: str
    state: int
    """Place of its state in the supervisor's order, counted from 1; 0: never started."""
    pid: int
    incarnation: int
    restarts: int
    started_ns: int
    """Start of this incarnation, monotonic clock."""
    reason: str
    """Why it is in this state."""
    last_end: str
    """How its last process ended; '' if none has."""
    last_end_ns: int
    """When, monotonic clock."""
    cpu_s: float
    rss_bytes: int
    """Memory of its process, shared memory it has touched included."""
    shared_bytes: int
    """Of these: shared memory, such as other modules' messages."""
    threads: int
    published: int
    """Messages handed to the core."""
    refused: int
    """Messages that memory, ring or tables had no room for."""
    handled: int
    ticks: int
    """Of this incarnation."""
    ticks_missed: int
    """Left out by this incarnation because it was too late for them."""
    waiting: int
    """Messages in its inbound queue."""
    waiting_peak: int
    waiting_bytes: int
    queue_messages: int
    """Limit of its inbound queue; 0: it has none."""
    queue_bytes: int
    outbound_waiting: int
    """Records in its outbound ring that the core has not read."""
    outbound_records: int
    """Capacity of its outbound ring."""
    pinned: int
    """Messages it has handled but still looks at."""
    pinned_bytes: int
    copied: int
    """Messages that it was given as copies, because it pins too much of their publishers' memory."""
    outstanding: int
    """Its own messages that somebody waits for or holds."""
    outstanding_bytes: int
    segment_bytes: int
    """Its data segments."""
    memory_bytes: int
    """Limit of its data segments."""
    status: str
    """Of a module that has ended: the last it had."""
    states: str
    """Of its state machines."""
    activity: str
    handler: str
    """The handler that is running; '' if none is."""
    busy_since_ns: int
    """Since when it has been doing what it does, monotonic clock; 0 while it is idle."""
    work: WorkHistograms | None
    """None while it has no process, and for the core."""
    subscriptions: tuple[SubscriptionFigures, ...]
    publishes: tuple[tuple[str, int, str], ...]
    """Type, version and topic of the channels that it has declared."""

    def total(self, column: str) -> int:
        """Sum of a column over its subscriptions."""
        return sum(getattr(entry, column) for entry in self.subscriptions)


@dataclass(frozen=True)
class ChannelFigures:
    """What has passed through one channel: the messages of one type and version on one topic."""

    type_name: str
    version: int
    topic: str
    messages: int
    bytes: int
    last_ns: int = 0
    """When the newest message was published, monotonic clock; 0: there was none."""
    intervals_squared: int = 0
    """Sum of the squares of all times between two messages, in us², modulo 2^64."""


@dataclass(frozen=True)
class CoreFigures:
    """What the core says of itself."""

    routed: int
    wakeups: int
    faults: int
    """How often a module broke the protocol."""
    heartbeat_ns: int
    """When it was last seen to work, monotonic clock."""
    handles: int
    """Messages on their way."""
    handles_limit: int
    references: int
    """Pairs of a message on its way and a subscription that it goes to."""
    references_limit: int


@dataclass(frozen=True)
class SegmentFigures:
    """One piece of shared memory."""

    name: str
    kind: str
    """board, core, out, in, data or checkpoint."""
    module: str
    """Whose it is; '' for the whole run's."""
    bytes: int


@dataclass(frozen=True)
class RunReading:
    """Everything known of a run at one moment."""

    at_ns: int
    """Monotonic clock."""
    wall_time_s: float
    """Unix time."""
    core: CoreFigures
    modules: tuple[ModuleFigures, ...]
    """In start order; the supervisor comes first, the core last."""
    channels: tuple[ChannelFigures, ...]
    segments: tuple[SegmentFigures, ...]
    machine: MachineReading

    def module(self, name: str) -> ModuleFigures | None:
        """Find a module."""
        return next((module for module in self.modules if module.name == name), None)
