"""A new core takes over what a dead one left: it finishes the one step that was cut short.

The dead core's memory is complete up to one store, and each step of the router ends in a commit (see
`ledger`). So at most one record of one ring has been handled in part. What it was is told by the tables
alone, whatever its module has written into the ring since:

- the last message whose handle row is committed is routed to whom it has not reached yet;
- the record of a message that is in the tables, or was, is taken;
- a message counted as refused is given back, and its record is taken;
- every other record is simply handled again: the steps it stands for do nothing when done before.

A row without a commit says nothing: a core that died before may have left one for a record that its successor
entered elsewhere.
"""

from robbie_mp.core.directory import Channel, Directory, Subscription
from robbie_mp.core.ledger import Ledger, Outcome
from robbie_mp.core.link import Link, Slot, checked
from robbie_mp.transport import layout
from robbie_mp.transport.records import MessageHandling, Outbound
from robbie_mp.transport.tables import DeclarationRow
from robbie_mp.transport.words import Words

KNOWN_DEAD = 8
"""So many earlier incarnations of each module may have died without their users having been told."""


def restore_slot(slot: Slot, words: Words) -> None:
    """Read a slot's counters."""
    slot.routed = words[slot.at + layout.PUBLISHER_ROUTED]
    slot.refused = words[slot.at + layout.PUBLISHER_REFUSED]
    if slot.refused and slot.refused == words[slot.at + layout.PUBLISHER_REFUSED_NTH]:
        slot.refused_record = (
            words[slot.at + layout.PUBLISHER_REFUSED_INCARNATION],
            words[slot.at + layout.PUBLISHER_REFUSED_RECORD],
        )
    slot.waiting_peak = words[slot.at + layout.PUBLISHER_WAITING_PEAK]


def restore_declarations(link: Link, directory: Directory) -> None:
    """Read again what a module has declared and the dead core has heard.

    Nothing is opened here: what is not in the tables is still to be said by a record in the ring. If it were
    opened now, a message cut short in routing would have more subscribers than there was room for.
    """
    for row in map(checked, DeclarationRow.read_all(link.out_words)):
        if row.kind == Outbound.ADVERTISE:
            channel = directory.known_channel(row.name)
            if channel is not None:
                link.channels[row.number] = channel
        elif (
            entry := directory.find(link.slot, row.name, MessageHandling(row.handling))
        ) is not None and entry.is_open:
            entry.declaration = row.number
            entry.declared_by = link.incarnation


def restore_references(slots: list[Slot], ledger: Ledger, directory: Directory) -> None:
    """Sort the references: which wait, which were pushed, which are pinned, which are to be closed."""
    waiting: list[tuple[int, int, int]] = []
    pushed: list[tuple[int, int]] = []
    for index, state in ledger.read_references(directory.subscriptions):
        sequence, _, subscription = ledger.reference(index)
        link = slots[subscription.slot].link
        pushed_at = ledger.pushed_at(index)
        if state is Outcome.DELIVERED and link is not None:
            link.pinned.add(index)
        elif state is not Outcome.HELD:
            ledger.close_reference(index)
        elif link is not None and 0 < pushed_at <= link.inbound.head:
            pushed.append((pushed_at, index))
        else:
            waiting.append((sequence, subscription.index, index))
    for pushed_at, index in sorted(pushed):
        restored = slots[ledger.reference(index)[2].slot].link
        assert restored is not None
        restored.pushed[index] = pushed_at - 1
        handle = ledger.handle(ledger.reference(index)[1])
        restored.in_flight[handle.source & layout.SOURCE_SLOT] += handle.size
    for _, _, index in sorted(waiting):
        _restore_waiting(slots, ledger, index)


def _restore_waiting(slots: list[Slot], ledger: Ledger, index: int) -> None:
    _, handle, subscription = ledger.reference(index)
    slot = slots[subscription.slot]
    ledger.mark_waiting(index)
    if subscription.newest_only:
        if subscription.queued is not None:
            slot.waiting_bytes -= slot.waiting.pop(subscription.queued)
            ledger.finish(subscription.queued, Outcome.REPLACED)
        subscription.queued = index
    size = ledger.handle(handle).size
    slot.waiting[index] = size
    slot.waiting_bytes += size


def unclaimed(ledger: Ledger, directory: Directory, handle: int, channel: Channel) -> list[Subscription]:
    """Subscriptions that a message cut short in routing has not reached yet."""
    sequence = ledger.handle(handle).sequence
    reached = ledger.claimants(handle)
    return [
        entry
        for entry in channel.subscriptions
        if not any(
            one.index in reached or ledger.was_claimed(one, sequence)
            for one in directory.alternatives(entry, channel)
        )
    ]
