"""Messages of the profiler service: the figures of `robbie top`."""

from typing import Any

from robbie_mp.messages.declaration import Upgrade
from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, float64, uint32, uint64
from robbie_mp.messages.stock.builtin_interfaces import Time


def _with_health(module: dict[str, Any]) -> dict[str, Any]:
    return {**module, "health": ""}


class ModuleProfile(
    Message, name="robbie_msgs/msg/ModuleProfile", version=2, upgrades={1: Upgrade(_with_health)}
):
    """One process of a run. Times that are not known are NaN; quantiles are of the last interval."""

    name: str = DEFAULT
    state: str = DEFAULT  # STARTING, RUNNING, BACKOFF, FAILED or STOPPED
    pid: uint32 = DEFAULT
    incarnation: uint64 = DEFAULT
    restarts: uint32 = DEFAULT
    last_end: str = DEFAULT  # how its last process ended
    uptime_s: float64 = DEFAULT  # of its process
    cpu_percent: float32 = DEFAULT  # of one processor
    rss_bytes: uint64 = DEFAULT
    threads: uint32 = DEFAULT
    in_hz: float32 = DEFAULT  # messages handled
    out_hz: float32 = DEFAULT  # messages handed to the core
    waiting: uint64 = DEFAULT  # messages in its queue
    waiting_peak: uint64 = DEFAULT
    waiting_limit: uint64 = DEFAULT
    outbound_waiting: uint32 = DEFAULT  # records that the core has not read
    overflowed: uint64 = DEFAULT  # messages dropped because its queue was full
    left: uint64 = DEFAULT  # messages that waited when it was stopped
    replaced: uint64 = DEFAULT
    lost: uint64 = DEFAULT
    refused: uint64 = DEFAULT
    pinned: uint64 = DEFAULT  # messages that it has handled and still uses
    pinned_bytes: uint64 = DEFAULT
    memory_used_bytes: uint64 = DEFAULT  # its messages on their way
    memory_limit_bytes: uint64 = DEFAULT
    latency_p50_s: float64 = DEFAULT  # from publishing a message to the start of its handler
    latency_p99_s: float64 = DEFAULT
    handler_mean_s: float64 = DEFAULT
    handler_p99_s: float64 = DEFAULT
    handler_max_s: float64 = DEFAULT
    lateness_p99_s: float64 = DEFAULT  # of ticks
    busy_s: float64 = DEFAULT  # time since it began its present work; 0: it waits
    handler: str = DEFAULT  # the handler that is running
    status: str = DEFAULT
    states: str = DEFAULT  # of its state machines
    health: str = DEFAULT  # why it is DEGRADED; empty: it is OK


class ChannelProfile(Message, name="robbie_msgs/msg/ChannelProfile", version=1):
    """The messages of one type on one topic."""

    message_type: str = DEFAULT
    topic: str = DEFAULT
    messages: uint64 = DEFAULT
    bytes: uint64 = DEFAULT
    hz: float32 = DEFAULT
    bytes_per_s: float64 = DEFAULT
    jitter_s: float64 = DEFAULT  # standard deviation of the time between two messages; NaN: not known
    age_s: float64 = DEFAULT  # of the last one; NaN: there was none


class SystemProfile(
    Message,
    name="robbie_msgs/msg/SystemProfile",
    version=2,
    upgrades={
        1: Upgrade(lambda fields: {**fields, "modules": [_with_health(one) for one in fields["modules"]]})
    },
):
    """A run and its machine during one interval."""

    stamp: Time = DEFAULT  # end of the interval
    interval_s: float64 = DEFAULT
    routed: uint64 = DEFAULT  # messages, since the run began
    routed_hz: float32 = DEFAULT
    messages_on_their_way: uint64 = DEFAULT
    cpu_percent: Array[float32] = DEFAULT  # of each processor
    load: Array[float32] = DEFAULT  # over 1, 5 and 15 minutes
    memory_available_bytes: uint64 = DEFAULT
    memory_total_bytes: uint64 = DEFAULT
    shared_memory_used_bytes: uint64 = DEFAULT
    shared_memory_total_bytes: uint64 = DEFAULT
    modules: list[ModuleProfile] = DEFAULT  # supervisor, modules in start order, core
    channels: list[ChannelProfile] = DEFAULT
