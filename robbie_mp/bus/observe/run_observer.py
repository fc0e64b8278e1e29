"""Reads all figures of a run."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robbie_mp.base.linux.proc import ProcessUsage, read_usage
from robbie_mp.bus.observe.connections import PATIENCE_S, Unconnected, unconnected, what
from robbie_mp.bus.observe.figures import (
    ChannelFigures,
    CoreFigures,
    MachineReading,
    ModuleFigures,
    RunReading,
    SegmentFigures,
    SubscriptionFigures,
    WorkHistograms,
)
from robbie_mp.bus.observe.module_memory import NO_WORDS, ModuleMemory
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.board import TOOL_PREFIX, Board
from robbie_mp.bus.transport.histogram import Histogram
from robbie_mp.bus.transport.layout import HISTOGRAM_WORDS, LINE_WORDS, Activity, HotPath, SegmentKind
from robbie_mp.bus.transport.segment import Segment, SegmentMissing
from robbie_mp.bus.transport.shared_folder import opened_folder
from robbie_mp.bus.transport.tables import ROW_OPEN, ChannelName, CoreTables, deadly_key
from robbie_mp.bus.transport.words import read_text

_ACTIVITIES = {int(activity): activity.name.lower() for activity in Activity}
_HOT_PATHS = {int(path): path.name for path in HotPath}
_OF_A_SLOT = re.compile("(?:out|in|data|checkpoint)-([0-9]+)-.*")
"""Names of segments that belong to a slot; others may stand beside them."""


class RunObserver:
    """Reads a run's figures on request.

    Args:
        run_id: the run.

    Raises:
        SegmentMissing: the run does not exist, or is just being made.
    """

    def __init__(self, run_id: str):
        self._run_id = run_id
        self._board_segment = Segment.attach(names.board(run_id), SegmentKind.BOARD)
        self._core_segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self._board = Board(self._board_segment.words)
        self._words = self._core_segment.words
        self._tables = CoreTables.attach(self._words)
        self._memories: dict[int, ModuleMemory] = {}

    def close(self) -> None:
        """Unmap the run."""
        for memory in self._memories.values():
            memory.close()
        self._board_segment.close()
        self._core_segment.close()

    @property
    def routed(self) -> int:
        """Messages the core has routed."""
        return self._words[layout.CORE_LAST_SEQUENCE]

    def read(self) -> RunReading:
        """Read all figures."""
        return RunReading(
            at_ns=time.monotonic_ns(),
            wall_time_s=time.time(),
            core=self.core(),
            modules=tuple(self.modules()),
            channels=tuple(self.channels()),
            segments=tuple(self.segments()),
            machine=MachineReading.now(),
            messages_flow=self._board.may_go,
        )

    def modules(self, *, only_counts: bool = False) -> list[ModuleFigures]:
        """Return the figures of all processes in start order: the supervisor is first, the core last.

        Attached tools are right before the core.

        Args:
            only_counts: whether to leave out what takes most of the time: what processes use of the machine,
                histograms, and subscriptions for which nobody publishes.
        """
        subscriptions = self._subscriptions()
        messages, sizes = self._outstanding()
        alone = {} if only_counts else self.unconnected()
        return [
            self._module(slot, subscriptions.get(slot, ()), messages[slot], sizes[slot], alone, only_counts)
            for slot in range(self._board.slots)
            if not self._board.is_left_by_tool(slot)
        ]

    def own_topics(self) -> dict[str, list[str]]:
        """Return the topics that each module has used, 10 s after its start, as its own code names them."""
        return {name: list(memory.topics) for name, memory, _ in self._settled()}

    def unconnected(self) -> dict[str, tuple[Unconnected, ...]]:
        """Return the subscriptions of each module for which nobody has published 10 s after its start.

        The start is the moment when messages began to flow, or when the module was restarted later. Channels
        stay in the core's tables, so a publisher that dies does not leave its subscribers unconnected.
        """
        settled = list(self._settled())
        if not settled:
            return {}
        published: dict[ChannelName, list[str]] = {row.name: [] for row in self._tables.channels()}
        for name, memory, _ in self._declared():
            for channel in memory.publishes:
                published.setdefault(channel, []).append(name)
        found = {name: tuple(unconnected(memory.needs, published)) for name, memory, _ in settled}
        return {name: alone for name, alone in found.items() if alone}

    def _settled(self) -> Iterator[tuple[str, ModuleMemory, int]]:
        """Yield the modules that have run long enough to judge what they are connected to."""
        went_ns = self._board.went_ns
        due_ns = time.monotonic_ns() - round(PATIENCE_S * 1e9)
        for name, memory, started_ns in self._declared() if went_ns else ():
            if max(went_ns, started_ns) < due_ns and memory.is_ready and not name.startswith(TOOL_PREFIX):
                yield name, memory, started_ns

    def _declared(self) -> Iterator[tuple[str, ModuleMemory, int]]:
        """Yield name, declarations and start of each process but the core, which declares nothing."""
        for slot in range(self._board.slots - 1):
            row = self._board.read(slot)
            if row.pid:
                memory = self._memory(slot, row.incarnation)
                memory.read_declarations()
                yield row.name, memory, row.started_ns
            elif self._board.is_left_by_tool(slot) and (left := self._memories.pop(slot, None)):
                left.close()  # or it would stay mapped until another tool takes the slot

    def channels(self) -> list[ChannelFigures]:
        """Return the figures of all channels."""
        return [
            ChannelFigures(
                **vars(row.counts),
                **row.name._asdict(),
                publishers=tuple(
                    self._board.name(slot) for slot in row.publishers if slot < self._board.slots
                ),
            )
            for row in self._tables.channels()
        ]

    def core(self) -> CoreFigures:
        """Return the figures of the core."""
        words, sizes = self._words, self._tables.sizes
        handles = self._table(self._tables.handle(0), sizes.handles, layout.HANDLE_WORDS)
        references = self._table(self._tables.reference(0), sizes.references, layout.REFERENCE_WORDS)
        return CoreFigures(
            routed=words[layout.CORE_LAST_SEQUENCE],
            wakeups=words[layout.CORE_WAKEUPS],
            faults=words[layout.CORE_FAULTS],
            heartbeat_ns=words[layout.CORE_HEARTBEAT_NS],
            handles=int(np.count_nonzero(handles[:, layout.HANDLE_SEQUENCE])),
            handles_limit=sizes.handles,
            references=int(np.count_nonzero(references[:, layout.REFERENCE_STATE])),
            references_limit=sizes.references,
            latched_not_given=words[layout.CORE_NOT_GIVEN],
        )

    def segments(self) -> list[SegmentFigures]:
        """Return the run's shared memory segments."""
        folder = names.folder(self._run_id)
        found = []
        with suppress(SegmentMissing), opened_folder(folder) as folder_fd:
            for file in os.listdir(folder_fd):
                try:
                    size = os.stat(file, dir_fd=folder_fd).st_size
                except FileNotFoundError:
                    continue
                kind = file.partition("-")[0]
                found.append(SegmentFigures(f"{folder}/{file}", kind, self._owner(file), size))
        return sorted(found, key=lambda segment: segment.name)

    # -- inside ----------------------------------------------------------------------------------------

    def _owner(self, file: str) -> str:
        """Return the name of the module whose segment it is, '' if it is of none."""
        match = _OF_A_SLOT.fullmatch(file)
        return self._board.name(int(match[1])) if match and int(match[1]) < self._board.slots else ""

    def _table(self, at: int, rows: int, row_words: int) -> NDArray[np.uint64]:
        """One of the core's tables, `(rows, row_words)`; the core may change it while you read."""
        words = np.frombuffer(self._core_segment.buffer, np.uint64)
        return words[at : at + rows * row_words].reshape(rows, row_words)

    def _outstanding(self) -> tuple[list[int], list[int]]:
        """For each slot: the number of its messages in flight, and their bytes."""
        table = self._table(self._tables.handle(0), self._tables.sizes.handles, layout.HANDLE_WORDS)
        live = table[table[:, layout.HANDLE_SEQUENCE] != 0]
        slots = live[:, layout.HANDLE_SOURCE].astype(np.int64) & 0xFFFF
        count = self._board.slots
        counts = np.bincount(slots, minlength=count)
        sizes = np.bincount(slots, live[:, layout.HANDLE_BYTES], minlength=count)
        return counts.tolist(), [round(size) for size in sizes.tolist()]

    def latched(self) -> list[ChannelName]:
        """Return the channels whose newest message the core keeps for later subscribers."""
        core = self._board.slots - 1
        return [row.name for row in self._tables.subscriptions() if row.slot == core]

    def _subscriptions(self) -> dict[int, tuple[SubscriptionFigures, ...]]:
        found: dict[int, tuple[SubscriptionFigures, ...]] = {}
        handles = self._table(self._tables.handle(0), self._tables.sizes.handles, layout.HANDLE_WORDS)
        sequences = handles[:, layout.HANDLE_SEQUENCE]
        live = {*map(deadly_key, sequences[sequences != 0].tolist())} - {0}
        for row in self._tables.subscriptions():
            name, counts, slot = row.name, row.counts, row.slot
            figures = SubscriptionFigures(
                **vars(counts),
                type_name=name.type_name,
                topic=name.topic,
                handling=row.handling.name,
                left=row.left_waiting(counts.dropped),
                version=name.version,
                is_open=row.state == ROW_OPEN,
                withheld=len(row.withheld & live),
                is_latch=slot == self._board.slots - 1,
            )
            found[slot] = (*found.get(slot, ()), figures)
        return found

    def _module(
        self,
        slot: int,
        subscriptions: tuple[SubscriptionFigures, ...],
        outstanding: int,
        outstanding_bytes: int,
        alone: dict[str, tuple[Unconnected, ...]],
        only_counts: bool,
    ) -> ModuleFigures:
        row, bounds = self._board.read(slot), self._board.bounds(slot)
        is_core = slot == self._board.slots - 1
        memory = self._memory(slot, 0 if is_core else row.incarnation)
        last = memory.own_words()
        own = last if row.pid else NO_WORDS  # a dead module's counts are in the row
        at = self._tables.publisher(slot)
        queue = [self._words[at + column] for column in range(layout.PUBLISHER_WORDS)]
        core_refused = queue[layout.PUBLISHER_REFUSED]
        usage = read_usage(row.pid) if row.pid and not only_counts else ProcessUsage()
        activity = own[layout.OUT_ACTIVITY]
        hot_path = self._words[layout.CORE_HOT_PATH] if is_core else last[layout.OUT_HOT_PATH]
        outbound_waiting, outbound_records = memory.outbound(own[layout.OUT_HEAD])
        memory.read_declarations()
        return ModuleFigures(
            name=row.name,
            state=row.state,
            pid=row.pid,
            incarnation=row.incarnation,
            restarts=row.restarts,
            started_ns=row.started_ns,
            reason=row.reason,
            last_end=row.last_end,
            last_end_ns=row.last_end_ns,
            cpu_s=row.past.cpu_ns / 1e9 + usage.cpu_s,
            rss_bytes=usage.rss_bytes,
            shared_bytes=usage.shared_bytes,
            threads=usage.threads,
            wakeups=usage.wakeups,
            published=row.past.published + own[layout.OUT_PUBLISHED],
            refused=row.past.refused + own[layout.OUT_REFUSED] + core_refused,
            handled=row.past.handled + own[layout.OUT_HANDLED],
            ticks=own[layout.OUT_TICKS],
            ticks_missed=own[layout.OUT_TICKS_MISSED],
            ticks_wait=bool(own[layout.OUT_TICKS_WAIT]),
            waiting=queue[layout.PUBLISHER_WAITING],
            waiting_peak=queue[layout.PUBLISHER_WAITING_PEAK],
            waiting_bytes=queue[layout.PUBLISHER_WAITING_BYTES],
            queue_messages=bounds.queue_messages,
            queue_bytes=bounds.queue_bytes,
            outbound_waiting=outbound_waiting,
            outbound_records=outbound_records,
            pinned=queue[layout.PUBLISHER_PINNED],
            pinned_bytes=own[layout.OUT_PINNED_BYTES],
            copied=own[layout.OUT_COPIED],
            ill_formed=row.past.ill_formed + own[layout.OUT_ILL_FORMED],
            outstanding=outstanding,
            outstanding_bytes=outstanding_bytes,
            segment_bytes=own[layout.OUT_SEGMENT_BYTES],
            memory_bytes=bounds.memory_bytes,
            status=read_text(last, layout.OUT_STATUS, LINE_WORDS),
            states=read_text(last, layout.OUT_STATES, LINE_WORDS),
            health=_health(
                read_text(own, layout.OUT_HEALTH, LINE_WORDS),
                self._board.health(slot) if row.pid else "",
                subscriptions,
            ),
            activity=_ACTIVITIES.get(activity & 0xFF, "unknown"),
            handler=memory.handler(activity >> 8) if activity & 0xFF == Activity.HANDLER else "",
            busy_since_ns=own[layout.OUT_ACTIVITY_SINCE_NS] if activity else 0,
            hot_path=_HOT_PATHS.get(hot_path, ""),
            work=_work(memory) if row.pid and not only_counts else None,
            subscriptions=tuple(_with_punctuality(one, memory) for one in subscriptions),
            publishes=tuple(memory.publishes),
            unconnected=alone.get(row.name, ()),
            renamed=tuple((own, actual) for own, actual in memory.topics.items() if own != actual),
        )

    def _memory(self, slot: int, incarnation: int) -> ModuleMemory:
        """The memory of an incarnation, 0 for none; that of the previous incarnation is unmapped."""
        known = self._memories.get(slot)
        if known is not None and known.incarnation == incarnation and (known.is_there or not incarnation):
            return known
        if known is not None:
            known.close()
        made = self._memories[slot] = ModuleMemory(self._run_id, slot, incarnation)
        return made


def _health(said: str, figured: str, subscriptions: tuple[SubscriptionFigures, ...]) -> str:
    """Why a module is DEGRADED.

    Args:
        said: what it says itself.
        figured: what the supervisor has concluded from its figures.
        subscriptions: tell which messages the core withholds from it.
    """
    withheld = (
        f"no longer gets the latched {what(one.type_name, one.topic)}: died over it twice"
        for one in subscriptions
        if one.withheld
    )
    return "; ".join(filter(None, (said, figured, *withheld)))


def _with_punctuality(figures: SubscriptionFigures, memory: ModuleMemory) -> SubscriptionFigures:
    name = ChannelName(figures.type_name, figures.version, figures.topic)
    newest_ns, deadline_ns, latenesses, greatest_age_ns = memory.punctuality(name)
    return replace(
        figures,
        age_s=max(0, time.monotonic_ns() - newest_ns) / 1e9 if newest_ns else None,
        deadline_s=deadline_ns / 1e9 if deadline_ns else None,
        latenesses=latenesses,
        greatest_age_s=greatest_age_ns / 1e9,
    )


def _work(memory: ModuleMemory) -> WorkHistograms | None:
    words = memory.histograms()
    if not words.size:
        return None
    return WorkHistograms(*(Histogram.read(words, number * HISTOGRAM_WORDS) for number in range(4)))
