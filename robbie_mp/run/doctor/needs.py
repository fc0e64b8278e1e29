"""The resources that a profile needs, computed from its limits."""

from dataclasses import dataclass
from math import ceil, log2

from typing_extensions import Self

from robbie_mp.bus.transport.layout import (
    CLOCK_WORDS,
    WAKEUP_WORDS,
    board_words,
    core_words,
    in_words,
    out_words,
)
from robbie_mp.bus.transport.words import WORD_BYTES
from robbie_mp.run.profile.model import MemoryLimits, Profile
from robbie_mp.run.supervisor.memory import SUPERVISOR_SEGMENT_BYTES
from robbie_mp.run.supervisor.own_history import AT_FIRST_BYTES

OWN_DESCRIPTORS = 32
"""Descriptors that a process has when it has just started."""
DESCRIPTORS_OF_A_CHILD = 9
"""The supervisor's descriptors for each child: pidfd, pipes, a spare's socket, maps of rings, a reserve."""
DESCRIPTORS_OF_A_MAP = 1


@dataclass(frozen=True)
class Needs:
    """The resources of a run.

    Attributes:
        profile: the profile's name.
        start_bytes: shared memory for tables, rings, and each module's first segment.
        limit_bytes: shared memory if each module's messages and both its checkpoints reach their limits and
            the maximum number of tools is attached.
        largest_file_bytes: the largest single segment.
        processes: supervisor, core, modules and spares.
        descriptors_to_start: needed at the start by the process that needs most.
        descriptors: the same when every module maps every segment of every other.
        realtime_priority: the highest that any process requests; 0: none.
        limits_wake_latency: whether any process limits the depth of processor sleep.
    """

    profile: str
    start_bytes: int
    limit_bytes: int
    largest_file_bytes: int
    processes: int
    descriptors_to_start: int
    descriptors: int
    realtime_priority: int = 0
    limits_wake_latency: bool = False

    @classmethod
    def of(cls, profile: Profile) -> Self:
        """Compute what a profile needs."""
        core, memories = profile.core, [module.memory for module in profile.modules]
        slots = len(memories) + 1
        rows = slots + profile.tools.count
        tables = core_words(rows + 1, core.channels, core.subscriptions, core.handles, core.references)
        rings = slots * (out_words(core.ring_records) + in_words(core.credits))
        words = board_words(rows + 1) + CLOCK_WORDS + tables + rings + (slots + 1) * WAKEUP_WORDS
        fixed_bytes = words * WORD_BYTES + SUPERVISOR_SEGMENT_BYTES
        tool_rings = out_words(core.ring_records) + in_words(profile.tools.credits) + WAKEUP_WORDS
        whole_bytes = profile.tools.count * tool_rings * WORD_BYTES
        whole_bytes += sum(memory.limit_bytes + 2 * memory.checkpoint_bytes for memory in memories)
        whole_bytes += sum(memory.history_bytes or 0 for memory in memories)
        maps = sum(segments(memory) for memory in memories) * DESCRIPTORS_OF_A_MAP
        to_start = OWN_DESCRIPTORS + DESCRIPTORS_OF_A_CHILD * (slots + profile.spares.count)
        schedulings = [core.scheduling, *(module.scheduling for module in profile.modules)]
        return cls(
            profile=profile.name,
            start_bytes=fixed_bytes + sum(bytes_at_start(memory) for memory in memories),
            limit_bytes=fixed_bytes + whole_bytes,
            largest_file_bytes=max(
                [tables * WORD_BYTES, *(max(m.limit_bytes, m.checkpoint_bytes) for m in memories)]
            ),
            processes=2 + len(memories) + profile.spares.count,
            descriptors_to_start=to_start,
            descriptors=max(to_start, OWN_DESCRIPTORS + maps),
            realtime_priority=max(one.realtime_priority for one in schedulings),
            limits_wake_latency=any(one.wake_latency_us is not None for one in schedulings),
        )


def bytes_at_start(memory: MemoryLimits) -> int:
    """Return the shared memory that a module takes at its start, without its rings."""
    return memory.segment_bytes + (AT_FIRST_BYTES if memory.history_bytes else 0)


def segments(memory: MemoryLimits) -> int:
    """Return how many data segments a module can create, each twice as large as the previous one."""
    return ceil(log2(memory.limit_bytes / memory.segment_bytes + 1))
