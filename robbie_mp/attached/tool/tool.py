"""A tool attached to a run; see `robbie_mp.run.supervisor.attached_tools` for the supervisor's side.

A tool may do less than a module. It copies each message and holds none. The supervisor may detach it at any
time; the message it was just copying is then discarded.
"""

import json
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.forks import keep_from_forks
from robbie_mp.bus._hot import choice
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.channels import ChannelCounters
from robbie_mp.bus.transport.layout import LINE_WORDS, Activity, ModulePhase
from robbie_mp.bus.transport.records import Delivery, Inbound, MessageHandling, Outbound
from robbie_mp.bus.transport.run_memory import make_block_store, make_views
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.tables import ROW_OPEN, ChannelName, CoreTables, SubscriptionRow
from robbie_mp.bus.transport.words import new_fence, write_text
from robbie_mp.messages import Message
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.membership import Membership
from robbie_mp.module.outbox import Outbox
from robbie_mp.run.control import ControlRefused, RunNotControlled, converse
from robbie_mp.run.declared_types import DeclaredTypes
from robbie_mp.run.plan import TOOL_MEMORY_BYTES, RunPlan
from robbie_mp.run.run_directory import KnownRun

SEGMENT_BYTES = 1 << 20
LONGEST_WAIT_S = 0.2
"""Upper limit of a wait: a tool checks at least this often whether it is still attached."""
PATIENCE_S = 2.0
"""How long a detached tool tries to attach again: the core may not have freed its old place yet."""


class Detached(RobbieError, ConnectionError):
    """The supervisor has detached a tool because it did not respond or broke the protocol."""


class RunEnded(RobbieError, ConnectionError):
    """The run that a tool is attached to has ended."""


@dataclass(frozen=True)
class Received:
    """A copy of a message and its envelope."""

    data: bytes
    type_name: str
    version: int
    topic: str
    sequence: int
    sender: str
    published_ns: int
    """On the machine's monotonic clock."""
    subscription: int
    """Number of the subscription that it arrived for, as returned by `Tool.subscribe`."""


class Tool:
    """A process attached to a run.

    Args:
        run: the run.
        purpose: what this process does, shown as its status.

    Attributes:
        outbox: publishes the tool's own messages.
        peers: the modules of the run.
        types: the message types of the run.

    Raises:
        ControlRefused: the profile allows no further tools, or shared memory is full.
        RunNotControlled: the run is still starting, or has ended.
    """

    def __init__(self, run: KnownRun, purpose: str):
        self._purpose = purpose
        self._subscriptions = 0
        self._connection, answer = converse(run.folder, {"command": "attach", "purpose": purpose})
        try:
            if not answer:
                raise RunEnded(f"run {run.run_id} has ended")
            if "error" in answer:
                raise ControlRefused(str(answer["error"]))
            self._pid, incarnation = int(answer["pid"]), int(answer["incarnation"])
            plan = RunPlan.load(run.folder)
            self._slot, self._incarnation = plan.names.index(str(answer["done"])), incarnation
            self.types = DeclaredTypes(run.folder, plan.types)
            self._map(plan, run.run_id)
        except (SegmentMissing, FileNotFoundError) as error:
            self._connection.close()
            raise RunEnded(f"run {run.run_id} has ended") from error
        except BaseException:
            self._connection.close()
            raise
        keep_from_forks(self)

    def disown(self) -> None:
        """Close a forked child's copy of the connection, so that the supervisor sees this tool end."""
        self._connection.close()

    def _map(self, plan: RunPlan, run_id: str) -> None:
        slot, incarnation = self._slot, self._incarnation
        native = choice.native()
        self._place = place = Membership(run_id, slot, incarnation, plan.tool_sizes, native)
        self._words, self._endpoint, self._board = place.words, place.endpoint, place.board
        blocks = make_block_store(run_id, slot, incarnation, SEGMENT_BYTES, TOOL_MEMORY_BYTES, native)
        self.outbox = Outbox(self._endpoint, blocks, self._words, SystemClock(), native)
        self.outbox.check_class = self.types.check
        self._views = make_views(run_id)
        self._tables = CoreTables.attach(place.core)
        self._counters = ChannelCounters(place.core)
        self._fence = new_fence()
        self.peers = place.peers
        self.show_status(self._purpose)

    def close(self) -> None:
        """Detach. Messages already published are still routed."""
        self.outbox.close()
        self._views.close()
        self._place.close()
        self._connection.close()  # last, because the supervisor then reclaims all the rest

    def subscribe(
        self,
        type_name: str,
        version: int,
        topic: str = "",
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> int:
        """Subscribe to messages of a type, on one topic or on all (''). They arrive after `ready`.

        With ANY_VERSION, type and topic are shell patterns.

        Returns:
            The number of this subscription.
        """
        self._subscriptions += 1
        return self._endpoint.subscribe(type_name, version, topic, handling)

    def ready(self) -> None:
        """Start receiving messages."""
        self._words[layout.OUT_READY] = ModulePhase.READY
        self._endpoint.send(Outbound.READY)

    def publish(self, message: Message, topic: str, latched: bool = False) -> bool:
        """Publish a message; False if it was refused because the memory or the ring is full."""
        return self.outbox.publish(message, topic, latched)

    def take(self) -> Received | None:
        """Return the next message, or None if there is none.

        Raises:
            Detached: the supervisor has detached this tool; the copy was discarded.
        """
        self._words[layout.OUT_ACTIVITY_SINCE_NS] = time.monotonic_ns()
        self._words[layout.OUT_ACTIVITY] = Activity.HANDLER
        try:
            while (record := self._endpoint.take()) is not None:
                if isinstance(record, Delivery):
                    return self._copy(record)
                if record.kind is Inbound.SEGMENTS_GONE:
                    self._views.drop(record.slot, record.incarnation)
        finally:
            self._words[layout.OUT_ACTIVITY] = Activity.IDLE
        return None

    def _copy(self, delivery: Delivery) -> Received:
        try:
            data = bytes(self._views.view(delivery.source, delivery.offset, delivery.size))
        except (SegmentMissing, SegmentMismatch):
            data = b""  # reclaimed after a detach, or destroyed by its publisher
        name = self._place.channel_name(delivery.channel)
        sender = self._board.name(layout.unpack_source(delivery.source)[0])
        self._fence()
        self._check_attached()
        self._endpoint.release(delivery)
        return Received(data, *name, delivery.sequence, sender, delivery.stamp_ns, delivery.declaration)

    def _check_attached(self) -> None:
        """Check that the memory read before this call still belonged to this tool.

        The supervisor updates the board before it lets the core reclaim the tool's messages.
        """
        if not self.is_attached:
            raise Detached("detached while it copied a message")

    @property
    def is_attached(self) -> bool:
        """Whether this tool is still attached. If it is not, its messages are not routed."""
        return self._board.is_attached_as(self._slot, self._incarnation, self._pid)

    def show_status(self, line: str) -> None:
        """Set the status line shown for this tool."""
        write_text(self._words, layout.OUT_STATUS, LINE_WORDS, line)

    def wait(self, timeout_s: float = LONGEST_WAIT_S) -> bool:
        """Wait for messages until the timeout, or at most LONGEST_WAIT_S, and notice the end of the run.

        Returns:
            False if nothing has woken this tool.

        Raises:
            Detached: the supervisor has detached this tool.
            RunEnded: the run has ended.
        """
        woken = self._place.memory.wakeup.wait(min(timeout_s, LONGEST_WAIT_S))
        if select.select([self._connection], [], [], 0)[0]:
            self._hear_the_end()
        return woken

    def wake(self) -> None:
        """End the present or next `wait`; any thread may call this."""
        self._place.memory.wakeup.post()

    def _hear_the_end(self) -> None:
        try:
            line = self._connection.recv(4096, socket.MSG_DONTWAIT)
        except OSError:
            line = b""
        if line:
            raise Detached(str(json.loads(line)["error"]))
        raise RunEnded("the run has ended")

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds; False if it does not within the timeout. Raises as `wait` does."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                return False
            self.wait(min(left_s, 0.005))
        return True

    # -- counters of the core -----------------------------------------------------------------------------

    def is_subscribed(self) -> bool:
        """Whether the core has opened all of this tool's subscriptions."""
        return len(self._rows()) >= self._subscriptions

    def counts(self) -> tuple[int, int]:
        """Return how many messages were routed to this tool, and how many still wait or are being copied."""
        counts = [row.counts for row in self._rows()]
        return sum(count.routed for count in counts), sum(count.waiting for count in counts)

    def _rows(self) -> list[SubscriptionRow]:
        rows = self._tables.subscriptions()
        return [row for row in rows if row.state == ROW_OPEN and row.slot == self._slot]

    def passed(self) -> dict[ChannelName, int]:
        """Return how many messages the core has routed through each channel since the run began."""
        return self._counters.messages()


def attach_again(run: KnownRun, purpose: str) -> Tool:
    """Attach a tool again after it was detached.

    Raises:
        ControlRefused: no place became free in time.
        RunEnded: the run has ended.
    """
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return Tool(run, purpose)
        except RunNotControlled as error:
            raise RunEnded(f"run {run.run_id} has ended") from error
        except ControlRefused:
            if time.monotonic() >= until_s:
                raise
        time.sleep(0.05)
