"""The supervisor's side of a run's shared memory: it creates and unlinks all names and informs the core."""

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace

from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.board import TOOL_PREFIX, Board, SlotBounds, SlotState, Totals
from robbie_mp.bus.transport.layout import Activity, ModulePhase, SegmentKind
from robbie_mp.bus.transport.records import Inbound, Notice, Outbound
from robbie_mp.bus.transport.run_memory import IncarnationMemory, make_block_store, make_endpoint
from robbie_mp.bus.transport.segment import Segment, unlink_segment
from robbie_mp.bus.transport.shared_folder import (
    SHARED_MEMORY,
    ForeignMemory,
    SegmentMissing,
    opened_folder,
    remove_file,
    remove_names,
)
from robbie_mp.bus.transport.tables import CoreTables, TableSizes
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.messages import ModuleState, Time
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.outbox import Outbox
from robbie_mp.run.plan import CORE, SUPERVISOR_MEMORY_BYTES, TOOL_MEMORY_BYTES, RunPlan
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.supervisor.capsules import Capsules, Evidence
from robbie_mp.run.supervisor.crash import LastWordsReader, describe_activity
from robbie_mp.run.supervisor.files_watch import Files, Owner
from robbie_mp.run.supervisor.incarnations import Doing
from robbie_mp.run.supervisor.states import STATES, ChildState, StateChange
from robbie_mp.run.trace.crash import CrashReport, LastWords

SUPERVISOR = "supervisor"
SUPERVISOR_SLOT = 0
SUPERVISOR_SEGMENT_BYTES = 64 << 10
_FAILED = STATES.index(ChildState.FAILED) + 1
_RUNNING = STATES.index(ChildState.RUNNING) + 1
_BEING_STARTED = {STATES.index(state) + 1 for state in (ChildState.STARTING, ChildState.BACKOFF)}


class RunMemory:
    """Board, core tables, and the memory of each incarnation. Implements `Incarnations` for the process tree.

    Args:
        plan: the run.
        on_change: called with every change of state, after the board shows it.

    Attributes:
        faulted: name and incarnation of each process that the core found breaking the protocol: a module,
            a tool, or SUPERVISOR itself.
        capsules: writes the capsules of crashes; None: none are written.
        before_close: called when all children have ended, while the memory can still be read.

    Raises:
        SharedMemoryFull: there is no room for the run's tables.
    """

    def __init__(self, plan: RunPlan, on_change: Callable[[StateChange], None] = lambda _change: None):
        self._plan = plan
        self._on_change = on_change
        self.before_close: Callable[[], None] = lambda: None
        self.capsules: Capsules | None = None
        self._run_id = plan.run_id
        self._slots = {name: slot for slot, name in enumerate(plan.names)}
        self._incarnations: dict[int, tuple[int, IncarnationMemory]] = {}
        self._dying: dict[int, bool] = {}
        """Slots whose module is dead but not yet reclaimed; whether its restart was ordered."""
        self._reclaimed: dict[int, int] = {}
        """For each slot, the incarnation that the core reclaimed last."""
        self._heartbeat_before = 0
        self._made = contextlib.ExitStack()
        """Everything that exists as long as the run."""
        self.faulted: list[tuple[str, int]] = []
        with contextlib.ExitStack() as on_failure:
            on_failure.callback(self.close)
            self._create()
            on_failure.pop_all()

    def _create(self) -> None:
        run_id, plan = self._run_id, self._plan
        rows = len(plan.names)
        made = self._made
        board = Segment.create(names.board(run_id), layout.board_words(rows), SegmentKind.BOARD)
        self.board = Board(made.enter_context(contextlib.closing(board)).words)
        queue = plan.tool_queue
        tools = [SlotBounds(queue.messages, queue.bytes, TOOL_MEMORY_BYTES)] * plan.tools.count
        supervisor = SlotBounds(memory_bytes=SUPERVISOR_MEMORY_BYTES)
        latched = SlotBounds(plan.core.latched_messages, plan.core.latched_bytes)
        self.board.create(plan.names, [supervisor, *map(_bounds, plan.modules), *tools, latched])
        now_ns = time.monotonic_ns()
        self.board.write(
            SUPERVISOR_SLOT, SlotState("", _RUNNING, os.getpid(), 1, 0, now_ns, "started", Totals())
        )
        clock = Segment.create(names.clock(run_id), layout.CLOCK_WORDS, SegmentKind.CLOCK)
        self._clock_words = made.enter_context(contextlib.closing(clock)).words
        limits = plan.core
        sizes = TableSizes(rows, limits.channels, limits.subscriptions, limits.handles, limits.references)
        core = Segment.create(names.core(run_id), sizes.words, SegmentKind.CORE)
        self._core_words = made.enter_context(contextlib.closing(core)).words
        wakeup = Wakeup.create(names.core_wakeup(run_id), None, core.words, layout.CORE_ASLEEP)
        self._core_wakeup = made.enter_context(contextlib.closing(wakeup))
        self._tables = CoreTables.create(core.words, sizes)
        inbound_records = layout.inbound_records(plan.sizes.credit)
        self._last_words = LastWordsReader(self._tables, self.board, inbound_records)
        own = IncarnationMemory.create(run_id, SUPERVISOR_SLOT, 1, plan.sizes)
        self._incarnations[SUPERVISOR_SLOT] = (1, own)
        self._own_words = own.out.words
        self._endpoint = make_endpoint(own, SUPERVISOR_SLOT, 1, plan.sizes, self._core_wakeup.post)
        blocks = make_block_store(
            run_id, SUPERVISOR_SLOT, 1, SUPERVISOR_SEGMENT_BYTES, SUPERVISOR_MEMORY_BYTES
        )
        outbox = Outbox(self._endpoint, blocks, own.out.words, SystemClock())
        self._outbox = made.enter_context(contextlib.closing(outbox))

    # -- what the process tree calls -------------------------------------------------------------------

    def open(self, name: str, incarnation: int) -> None:
        """Create the memory of a child that is about to start, and inform the core."""
        slot = self._slots[name]
        if name == CORE:
            self._open_core(incarnation)
            return
        sizes = self._plan.tool_sizes if name.startswith(TOOL_PREFIX) else self._plan.sizes
        memory = IncarnationMemory.create(self._run_id, slot, incarnation, sizes)
        self._incarnations[slot] = (incarnation, memory)
        self._endpoint.send(Outbound.MODULE_UP, slot, incarnation)

    def _open_core(self, incarnation: int) -> None:
        """Repeat to a restarted core what its predecessor may have read but not finished or answered."""
        self._heartbeat_before = self._core_words[layout.CORE_HEARTBEAT_NS]
        if incarnation == 1:
            return
        for slot, (of_slot, _) in self._incarnations.items():
            if slot != SUPERVISOR_SLOT:
                kind = Outbound.MODULE_DOWN if slot in self._dying else Outbound.MODULE_UP
                self._endpoint.send(kind, slot, of_slot, self._dying.get(slot, False))
                if self.board.read(slot).state == _FAILED:  # it hangs in the kernel and stays connected
                    self._endpoint.send(Outbound.MODULE_GONE, slot, 0)

    def started(self, name: str, incarnation: int, pid: int) -> None:
        """Write a child's pid on the board."""
        slot = self._slots[name]
        row = self.board.read(slot)
        self.board.write(slot, replace(row, pid=pid, incarnation=incarnation, started_ns=time.monotonic_ns()))

    def is_ready(self, name: str, incarnation: int) -> bool:
        """Whether a child has finished its setup."""
        if name == CORE:
            return self._core_words[layout.CORE_HEARTBEAT_NS] != self._heartbeat_before
        current, memory = self._incarnations[self._slots[name]]
        return current == incarnation and memory.out.words[layout.OUT_READY] in (
            ModulePhase.READY,
            ModulePhase.ENDED,
        )

    def has_ended(self, name: str, incarnation: int) -> bool:
        """Whether a dead child has ended as it was meant to."""
        if name == CORE:
            return True
        current, memory = self._incarnations[self._slots[name]]
        return current == incarnation and memory.out.words[layout.OUT_READY] == ModulePhase.ENDED

    def awaits_time(self, name: str) -> bool:
        """Whether a child may be waiting for a module that is starting to set the run's time."""
        source = self._plan.clock.source
        if source in (None, name) or name == CORE or self._clock_words[layout.CLOCK_NUMBER]:
            return False
        return self.slot_state(source).state in _BEING_STARTED

    def doing(self, name: str, incarnation: int) -> Doing | None:
        """Return the present activity of a child, or None if it is idle and has taken all its messages.

        A module writes the activity and its start one after the other. Read between the two writes, the
        module seems to begin something new, which is correct. The core is never idle: each heartbeat begins a
        new activity. A module that leaves messages in its ring is "idle since" the message that it took last.
        A healthy module takes the next one at once; one that does not is stopped, or its loop hangs.
        """
        if name == CORE:
            return Doing(Activity.HANDLER, 0, self._core_words[layout.CORE_HEARTBEAT_NS])
        current, memory = self._incarnations[self._slots[name]]
        words = memory.out.words
        activity = words[layout.OUT_ACTIVITY]
        if current != incarnation:
            return None
        if activity == Activity.IDLE:
            taken = words[layout.OUT_INBOUND_TAIL]
            # Before the run starts, no module takes messages.
            leaves_messages = self.board.may_go and memory.into.words[layout.IN_HEAD] != taken
            return Doing(Activity.IDLE, 0, taken) if leaves_messages else None
        try:
            kind = Activity(activity & 0xFF)
        except ValueError:
            return None  # an invalid value; the core detects and reports it
        return Doing(kind, activity >> 8, words[layout.OUT_ACTIVITY_SINCE_NS])

    def describe(self, name: str, incarnation: int, doing: Doing) -> str:
        """Describe an activity of a child that has taken too long."""
        if name == CORE:
            return "sent no heartbeat"
        if doing.activity is Activity.IDLE:
            return "hung: it took none of the messages in its ring"
        words = self._incarnations[self._slots[name]][1].out.words
        return f"hung in {describe_activity(words, doing.activity | doing.subscription << 8)}"

    def last_words(self, name: str, incarnation: int) -> LastWords:
        """Return the evidence in a dead child's memory."""
        current, memory = self._incarnations.get(self._slots[name], (0, None))
        if memory is None or current != incarnation:
            return LastWords()
        return self._last_words.read(memory.out.words, memory.into.words)

    def keep_evidence(self, report: CrashReport) -> None:
        """Have a capsule made of a module's crash."""
        slot = self._slots[report.module]
        current, memory = self._incarnations.get(slot, (0, None))
        if self.capsules is None or memory is None or current != report.incarnation:
            return
        place = self._last_words.last_place(memory.out.words, memory.into.words)
        self.capsules.take(report, Evidence(slot, current, place))

    def died(self, name: str, incarnation: int, *, was_ordered: bool = False) -> None:
        """Have the core reclaim what a dead module held; add its counters to those of its predecessors."""
        if name == CORE:
            return
        slot = self._slots[name]
        words = self._incarnations[slot][1].out.words
        row = self.board.read(slot)
        past = replace(
            row.past,
            published=row.past.published + words[layout.OUT_PUBLISHED],
            refused=row.past.refused + words[layout.OUT_REFUSED],
            handled=row.past.handled + words[layout.OUT_HANDLED],
            checkpoints=row.past.checkpoints + words[layout.OUT_CHECKPOINTS],
            ill_formed=row.past.ill_formed + words[layout.OUT_ILL_FORMED],
        )
        self.board.write(slot, replace(row, pid=0, past=past))
        self._dying[slot] = was_ordered
        self._endpoint.send(Outbound.MODULE_DOWN, slot, incarnation, was_ordered)

    def is_reclaimed(self, name: str, incarnation: int) -> bool:
        """Whether the core has reclaimed everything, so that the next incarnation may start."""
        if name == CORE:
            return True
        slot = self._slots[name]
        self.read_notices()
        if self._reclaimed.get(slot) != incarnation:
            return False
        self._dying.pop(slot, None)
        _, memory = self._incarnations.pop(slot)
        memory.close()
        memory.unlink()
        unlink_segment(names.history(self._run_id, slot, incarnation))
        return True

    def wake(self, name: str, incarnation: int) -> None:
        """Wake a child, so that it handles a signal even while it waits."""
        if name == CORE:
            self._core_wakeup.post()
            return
        current, memory = self._incarnations.get(self._slots[name], (0, None))
        if memory is not None and current == incarnation:
            memory.wakeup.post()

    def state_changed(self, change: StateChange) -> None:
        """Show a child's new state on the board and publish it to the modules."""
        slot = self._slots[change.name]
        row = self.board.read(slot)
        restarts = row.restarts + (change.old is not None and change.new is ChildState.STARTING)
        pid = row.pid if change.new.has_process else 0
        state = STATES.index(change.new) + 1
        past = row.past
        if change.exit_status is not None:
            past = replace(past, cpu_ns=past.cpu_ns + round(change.exit_status.cpu_s * 1e9))
        row = replace(row, state=state, pid=pid, restarts=restarts, reason=change.reason, past=past)
        if change.exit_status is not None:
            row = replace(row, last_end=change.reason, last_end_ns=time.monotonic_ns())
        self.board.write(slot, row)
        # The memory of a process that hangs in the kernel must not be touched: the process may continue.
        is_dead = slot in self._dying or slot not in self._incarnations
        if change.new.is_final and change.name != CORE and is_dead:
            clean = change.new is ChildState.STOPPED
            self._endpoint.send(Outbound.MODULE_GONE, slot, int(clean))
        message = ModuleState(
            stamp=Time.from_nanoseconds(round(change.wall_time_s * 1e9)),
            module=change.name,
            state=str(change.new),
            incarnation=change.incarnation,
            pid=pid,
            restarts=restarts,
            reason=change.reason,
        )
        self._outbox.publish(message, "")
        self._on_change(change)

    def show_health(self, name: str, line: str) -> None:
        """Show on the board why a module's figures make it DEGRADED; '': they do not."""
        self.board.show_health(self._slots[name], line)

    def attached(self, name: str, incarnation: int, pid: int) -> None:
        """Show on the board that a tool is attached."""
        self.started(name, incarnation, pid)
        slot = self._slots[name]
        self.board.write(slot, replace(self.board.read(slot), state=_RUNNING, past=Totals()))

    def detached(self, name: str, incarnation: int, reason: str) -> None:
        """Mark a tool as detached, then have the core reclaim what it held and remove its subscriptions.

        In this order, because a tool that is stopped while it copies a message looks at the board afterwards.
        """
        slot = self._slots[name]
        self.board.write(slot, replace(self.board.read(slot), state=0, pid=0, reason=reason))
        self.died(name, incarnation)
        self._endpoint.send(Outbound.MODULE_GONE, slot, 1)

    def unread(self, name: str) -> tuple[int, int]:
        """Return how many records wait in a tool's inbound ring, and how many it has ever taken."""
        _, memory = self._incarnations[self._slots[name]]
        taken = memory.out.words[layout.OUT_INBOUND_TAIL]
        return memory.into.words[layout.IN_HEAD] - taken, taken

    def are_subscribed(self) -> bool:
        """Whether the core has read what all running modules have subscribed.

        A busy core may not have read it yet when they are ready. What others publish then would pass them by.
        """
        return all(
            self._core_words[self._tables.publisher(slot) + layout.PUBLISHER_READY] == incarnation
            for slot, (incarnation, _) in self._incarnations.items()
            if 0 < slot <= len(self._plan.modules) and self.board.read(slot).state == _RUNNING
        )

    def all_started(self) -> None:
        """Let messages flow."""
        self.board.go()
        for slot, (_, memory) in self._incarnations.items():
            if slot != SUPERVISOR_SLOT:
                memory.wakeup.post()

    def files(self) -> Files:
        """Return the files that the supervisor has made and not removed, without those of dead modules."""
        run = (names.board, names.clock, names.core, names.core_wakeup)
        found: dict[str, Owner | None] = {f"{SHARED_MEMORY}/{name(self._run_id)}": None for name in run}
        for slot, (incarnation, _) in self._incarnations.items():
            if slot not in self._dying:
                owner = self._owner(slot, incarnation)
                for name in (names.outbound, names.inbound, names.wakeup):
                    found[f"{SHARED_MEMORY}/{name(self._run_id, slot, incarnation)}"] = owner
        return found

    def data_files(self) -> Files:
        """Return the data segments of all live modules and tools."""
        # No glob: Python would keep a pattern for each incarnation.
        owners = {
            names.data_prefix(self._run_id, slot, incarnation): self._owner(slot, incarnation)
            for slot, (incarnation, _) in self._incarnations.items()
            if slot not in self._dying
        }
        folder, found = names.folder(self._run_id), {}
        with contextlib.suppress(OSError):  # that nothing is there any more, `files` shows
            for file in os.listdir(SHARED_MEMORY / folder):
                prefix = f"{folder}/{file[: file.rfind('-') + 1]}"
                if prefix in owners:
                    found[f"{SHARED_MEMORY}/{folder}/{file}"] = owners[prefix]
        return found

    def _owner(self, slot: int, incarnation: int) -> Owner | None:
        return (self._plan.names[slot], incarnation) if slot != SUPERVISOR_SLOT else None

    def close(self) -> None:
        """Unmap and unlink everything of this run."""
        self.before_close()
        for _, memory in self._incarnations.values():
            memory.close()
        self._made.close()
        remove_names(self._run_id)

    def beat(self) -> None:
        """Show the core that the supervisor makes progress."""
        self._own_words[layout.OUT_ACTIVITY_SINCE_NS] = time.monotonic_ns()

    # -- notices from the core --------------------------------------------------------------------------

    def read_notices(self) -> None:
        """Read the core's notices to the supervisor."""
        while (record := self._endpoint.take()) is not None:
            if not isinstance(record, Notice):
                continue  # the supervisor subscribes to nothing
            if record.kind is Inbound.RECLAIMED:
                self._reclaimed[record.slot] = record.incarnation
            elif record.kind is Inbound.SEGMENTS_GONE:
                unlink_data_segments(self._run_id, record.slot, record.incarnation)
            elif record.kind is Inbound.FAULTED:
                self.faulted.append((self._plan.names[record.slot], record.incarnation))

    def slot_state(self, name: str) -> SlotState:
        """Return a child's row of the board."""
        return self.board.read(self._slots[name])


def _bounds(module: ModuleSpec) -> SlotBounds:
    return SlotBounds(module.queue.messages, module.queue.bytes, module.memory.limit_bytes)


def unlink_data_segments(run_id: str, slot: int, incarnation: int) -> None:
    """Remove the names of a dead publisher's data segments."""
    folder, _, prefix = names.data_prefix(run_id, slot, incarnation).partition("/")
    # glob would cache a compiled pattern for each prefix
    with contextlib.suppress(SegmentMissing, ForeignMemory), opened_folder(folder) as fd:
        for file in os.listdir(fd):
            if file.startswith(prefix):
                with contextlib.suppress(OSError):
                    remove_file(file, fd)
