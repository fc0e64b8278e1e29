"""A new core takes over what a dead one left, and finishes the one step that was cut short.

The dead core's memory is complete up to one store, and every step of the router ends in a commit (see
`ledger`). So at most one record of one ring has been handled in part. The tables alone tell which one,
whatever the module has written into its ring since:

- The last message whose handle row is committed is routed to the subscribers that it has not reached yet.
- If the tables show that a message was entered, its record is taken from the ring.
- If a message was counted as refused, its block is given back and its record is taken from the ring.
- A subscription of a module that is ready is handled, and its record is taken from the ring.
- Every other record is handled again. The steps it stands for do nothing when they were done before.

A row without a commit proves nothing: an earlier core may have died and left it for a record that its
successor entered in another row.

Everything that the router does has its counterpart here, so read this page with `ledger` beside it.
"""

from collections.abc import Mapping, Sequence

from robbie_mp.bus.core.declarations import Declarations
from robbie_mp.bus.core.directory import Channel, Directory, Subscription
from robbie_mp.bus.core.flow import FreedBlocks, MessageFlow
from robbie_mp.bus.core.ledger import Ledger
from robbie_mp.bus.core.members import MODULE_ERRORS, Link, Members, Slot, checked
from robbie_mp.bus.core.queues import Queues
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import MessageHandling, Outbound
from robbie_mp.bus.transport.tables import DeclarationRow, Outcome
from robbie_mp.bus.transport.words import Words, row_reader, row_writer

MAX_UNANNOUNCED = 8
"""Number of each module's last incarnations whose end the dead core may not have announced to everyone."""


class Takeover:
    """Rebuilds the parts of a router from the tables and the rings. On fresh tables it changes nothing.

    Args:
        words: the core segment.
        slots: every module of the run.
        ledger: without handles and references yet.
        directory: with the channels and subscriptions of the tables.
        queues: empty.
        members: without links yet.
        blocks: the way back of memory.
        flow: the way of messages.
        declarations: handles what modules declare.
    """

    def __init__(
        self,
        words: Words,
        slots: Sequence[Slot],
        ledger: Ledger,
        directory: Directory,
        queues: Queues,
        members: Members,
        blocks: FreedBlocks,
        flow: MessageFlow,
        declarations: Declarations,
    ):
        self._words = words
        self._slots = slots
        self._ledger = ledger
        self._directory = directory
        self._queues = queues
        self._members = members
        self._blocks = blocks
        self._flow = flow
        self._declarations = declarations

    def run(self) -> None:
        """Take over. A core that dies during this leaves what its own successor can take over."""
        for slot in self._slots:  # connect with the modules that the dead core was connected with
            if incarnation := self._words[slot.at + layout.PUBLISHER_LINKED]:
                self._members.connect(slot.index, incarnation)
        handles = self._restore_handles()
        for link in self._members.links:
            self._restore_link(link)
        self._restore_references()
        self._finish_routing(handles)
        entered = self._entered()
        for link in self._members.links:
            try:
                self._finish_publishing(link, entered)
                self._finish_subscribing(link)
            except MODULE_ERRORS as error:
                self._members.fault(link, error)
        for index in handles:
            if self._ledger.is_live(index) and not self._ledger.holders(index):
                self._blocks.give_back(index)
        self._announce_dead_publishers()
        self._resume()

    # -- reading what the dead core left ---------------------------------------------------------------

    def _restore_handles(self) -> list[int]:
        """Find the live messages; return the indices of their rows."""
        ledger = self._ledger
        found = {index: ledger.read_handle(index).handle for index in ledger.live_handles()}
        ledger.adopt_handles(found)
        return list(found)

    def _restore_link(self, link: Link) -> None:
        at = self._slots[link.slot].at
        link.ready = self._words[at + layout.PUBLISHER_READY] == link.incarnation
        try:
            self._restore_declarations(link)
        except MODULE_ERRORS as error:
            self._members.fault(link, error)

    def _restore_declarations(self, link: Link) -> None:
        """Read a module's declarations again, as far as the dead core had handled their records.

        This opens nothing. A declaration that is not in the tables is handled when its record is: opening it
        here could give a message that was cut short more subscribers than there was room for.
        """
        for row in map(checked, DeclarationRow.read_all(link.out_words)):
            if row.kind == Outbound.ADVERTISE:
                channel = self._directory.known_channel(row.name)
                if channel is not None:
                    link.channels = {**link.channels, row.number: channel}
                continue
            entry = self._directory.find(link.slot, row.name, MessageHandling(row.handling))
            if entry is not None and entry.is_open:
                entry.declaration = row.number
                entry.declared_by = link.incarnation

    def _restore_references(self) -> None:
        """Find out which references wait, which were pushed, which are pinned, and close the others."""
        ledger = self._ledger
        waiting: list[tuple[int, int, int]] = []
        pushed: list[tuple[int, int, Link]] = []
        for index, state in self._read_references().items():
            sequence, _, subscription = ledger.reference(index)
            link = self._slots[subscription.slot].link
            pushed_at = ledger.read_reference(index).pushed_at
            if state is Outcome.DELIVERED and link is not None:
                link.pinned[index] = 0
            elif state is not Outcome.HELD:
                ledger.close_reference(index)
            elif link is not None and 0 < pushed_at <= link.inbound.head:
                pushed.append((pushed_at, index, link))
            else:
                waiting.append((sequence, subscription.index, index))
        for pushed_at, index, link in sorted(pushed, key=lambda entry: entry[:2]):
            link.pushed[index] = pushed_at - 1
            handle = ledger.handle(ledger.reference(index)[1])
            link.in_flight[handle.source & layout.SOURCE_SLOT] += handle.size
        for _, _, index in sorted(waiting):
            self._restore_waiting(index)

    def _read_references(self) -> Mapping[int, Outcome]:
        """Find the references, and complete the counters whose new values they carry; return their states."""
        ledger = self._ledger
        found: dict[int, tuple[int, int, Subscription]] = {}
        states: dict[int, Outcome] = {}
        for index in ledger.live_references():
            row = ledger.read_reference(index)
            subscription = self._directory.subscriptions[row.subscription]
            found[index] = (row.sequence, row.handle, subscription)
            states[index] = row.state
            self._complete_count(subscription, row.state - 1, row.nth)
        ledger.adopt_references(found)
        return states

    def _complete_count(self, subscription: Subscription, column: int, nth: int) -> None:
        at = subscription.at + layout.SUBSCRIPTION_ROUTED + column
        counted = self._words[at]
        if counted < nth:
            self._words[at] = nth

    def _restore_waiting(self, index: int) -> None:
        ledger = self._ledger
        _, handle, subscription = ledger.reference(index)
        slot = self._slots[subscription.slot]
        ledger.mark_waiting(index)
        if subscription.newest_only:
            if subscription.queued is not None:
                slot.waiting_bytes -= slot.waiting.pop(subscription.queued)
                ledger.finish(subscription.queued, Outcome.REPLACED)
            subscription.queued = index
        size = ledger.handle(handle).size
        slot.waiting[index] = size
        slot.waiting_bytes += size

    # -- finishing the step that was cut short -----------------------------------------------------------

    def _finish_routing(self, handles: Sequence[int]) -> None:
        """Finish routing the last message that was entered.

        Args:
            handles: rows of all messages.
        """
        ledger = self._ledger
        index = max(handles, key=lambda row: ledger.handle(row).sequence, default=None)
        if index is None:
            return
        row = ledger.read_handle(index)
        handle = ledger.handle(index)
        slot = self._slots[layout.unpack_source(handle.source)[0]]
        channel = self._directory.by_index(handle.channel)
        figures = row_reader(self._words, 4)(channel.figures_at)
        messages, total_bytes, *times = figures
        if self._routed(slot) < row.publisher_routed:
            self._flow.route(slot, channel, figures, index, handle, self._unclaimed(index, channel))
        elif messages < row.channel_messages or total_bytes < row.channel_bytes:
            before = (row.channel_messages - 1, row.channel_bytes - handle.size, *times)
            channel.count(row_writer(self._words, 4), before, handle.size, handle.stamp_ns)

    def _routed(self, slot: Slot) -> int:
        """Return the number of a module's messages that were routed to their end."""
        return self._words[slot.at + layout.PUBLISHER_ROUTED]

    def _unclaimed(self, handle: int, channel: Channel) -> list[Subscription]:
        """Return the subscriptions that a message cut short in routing has not reached yet."""
        ledger = self._ledger
        sequence = ledger.handle(handle).sequence
        reached = ledger.claimants(handle)
        return [
            entry
            for entry in channel.subscriptions
            if not any(
                one.index in reached or ledger.was_claimed(one, sequence)
                for one in self._directory.alternatives(entry, channel)
            )
        ]

    def _entered(self) -> set[tuple[int, int, int]]:
        """Return slot, incarnation and outbound record of every message that the tables show was entered.

        A row still shows this after its message was given back. A row that was never committed looks the
        same, but the count of its publisher has not reached the count in the row.
        """
        found = set()
        for index in self._ledger.used_handles():
            row = self._ledger.read_handle(index)
            slot, _, incarnation = layout.unpack_source(row.handle.source)
            if row.handle.sequence or self._routed(self._slots[slot]) >= row.publisher_routed:
                found.add((slot, incarnation, row.record))
        return found

    def _finish_publishing(self, link: Link, entered: set[tuple[int, int, int]]) -> None:
        """Take the record at a ring's tail if it is a message that was entered or refused.

        Args:
            link: to the publisher.
            entered: slot, incarnation and record of the messages that were entered.
        """
        record = (link.incarnation, link.outbound.tail)
        if (link.slot, *record) in entered:
            link.outbound.take()
        elif self._refused_record(self._slots[link.slot]) == record and link.outbound.waiting():
            self._blocks.free(link, link.outbound.peek()[6])
            link.outbound.take()

    def _finish_subscribing(self, link: Link) -> None:
        """Handle the record at a ring's tail if it is a subscription of a module that is ready.

        The dead core may have given it messages of latched channels. They are still in the module's queue,
        because nothing has been pushed since; later, this core could not tell which ones were given.
        """
        if link.ready and link.outbound.waiting() and link.outbound.glance() == Outbound.SUBSCRIBE:
            self._declarations.on_subscribe(self._slots[link.slot], link, link.outbound.peek())
            link.outbound.take()

    def _refused_record(self, slot: Slot) -> tuple[int, int] | None:
        """Return incarnation and number of the outbound record of the message that was refused last."""
        words, at = self._words, slot.at
        refused = words[at + layout.PUBLISHER_REFUSED]
        if refused and refused == words[at + layout.PUBLISHER_REFUSED_NTH]:
            return (
                words[at + layout.PUBLISHER_REFUSED_INCARNATION],
                words[at + layout.PUBLISHER_REFUSED_RECORD],
            )
        return None

    # -- telling the modules -----------------------------------------------------------------------------

    def _announce_dead_publishers(self) -> None:
        """Find out which messages outlive their publishers, and announce the publishers that have none."""
        connected = {link.source for link in self._members.links}
        live = self._ledger.live_of_sources()
        self._blocks.dead_sources = {source: live[source] for source in live if source not in connected}
        for slot in self._slots:
            last = self._words[slot.at + layout.PUBLISHER_LAST_INCARNATION]
            for incarnation in range(max(1, last - MAX_UNANNOUNCED), last + 1):
                source = layout.pack_source(slot.index, 0, incarnation)
                if source not in connected and source not in self._blocks.dead_sources:
                    self._members.announce_gone((slot.index, incarnation))

    def _resume(self) -> None:
        """Send the modules what their credit allows, and wake all of them: any may wait for the dead core."""
        for slot in self._slots:
            if slot.link is not None:
                if slot.link.ready:
                    self._queues.pump(slot, slot.link)
                slot.link.wake()
            self._queues.outdate(slot)
        self._queues.post()
        self._queues.write_figures()
        for link in self._members.links:
            self._blocks.await_total(link, link.out_words[layout.OUT_AWAITED_FREED])
