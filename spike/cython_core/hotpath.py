# cython: boundscheck=False, wraparound=False
"""Spike: ring, ledger, queues and flow of the core in Cython's pure-Python mode."""
import cython
from array import array
from cython.cimports.robbie_mp.bus.transport.shared_words import SharedWords, fence, fence_loads, fence_stores
from robbie_mp.bus.transport.ring import RingCorrupt
from robbie_mp.bus.core.ledger import Handle, HandleRow, ReferenceRow
from robbie_mp.bus.transport.tables import Outcome
from collections import Counter

NONE = cython.declare(cython.ulonglong, 0xFFFFFFFF)


@cython.final
@cython.cclass
class RingWriter:
    words: SharedWords
    tail_words: SharedWords
    head_at: cython.ulonglong
    records_at: cython.ulonglong
    mask: cython.ulonglong
    capacity: cython.ulonglong
    tail_at: cython.ulonglong
    head = cython.declare(cython.ulonglong, visibility="public")

    def __init__(self, place):
        self.words, self.tail_words = place.words, place.tail_words
        self.head_at, self.records_at, self.tail_at = place.head_at, place.records_at, place.tail_at
        self.capacity = place.capacity
        self.mask = place.capacity - 1
        self.head = self.words.load(self.head_at)

    def room(self):
        tail: cython.ulonglong = self.tail_words.load(self.tail_at)
        fence_loads()
        if tail > self.head or self.head - tail > self.capacity:
            return 0
        return self.capacity - (self.head - tail)

    @cython.ccall
    @cython.exceptval(check=False)
    def push(self, a: cython.ulonglong, b: cython.ulonglong, c: cython.ulonglong, d: cython.ulonglong,
             e: cython.ulonglong, f: cython.ulonglong, g: cython.ulonglong) -> cython.void:
        head: cython.ulonglong = self.head
        words: SharedWords = self.words
        at: cython.ulonglong = self.records_at + (head & self.mask) * RECORD_WORDS
        words.store(at, a)
        words.store(at + 1, b)
        words.store(at + 2, c)
        words.store(at + 3, d)
        words.store(at + 4, e)
        words.store(at + 5, f)
        words.store(at + 6, g)
        words.store(at + 7, head + 1)
        fence_stores()
        words.store(self.head_at, head + 1)
        self.head = head + 1

    def close(self):
        pass


@cython.final
@cython.cclass
class RingReader:
    words: SharedWords
    tail_words: SharedWords
    head_at: cython.ulonglong
    records_at: cython.ulonglong
    mask: cython.ulonglong
    capacity: cython.ulonglong
    tail_at: cython.ulonglong
    tail = cython.declare(cython.ulonglong, visibility="public")
    record: cython.ulonglong[8]

    def __init__(self, place):
        self.words, self.tail_words = place.words, place.tail_words
        self.head_at, self.records_at, self.tail_at = place.head_at, place.records_at, place.tail_at
        self.capacity = place.capacity
        self.mask = place.capacity - 1
        self.tail = self.tail_words.load(self.tail_at)

    @cython.ccall
    @cython.exceptval(-1)
    def waiting(self) -> cython.longlong:
        waiting: cython.ulonglong = self.words.load(self.head_at) - self.tail
        fence_loads()
        if waiting > self.capacity:
            raise RingCorrupt(f"a ring of {self.capacity} records claims that {waiting} wait")
        return waiting

    @cython.cfunc
    @cython.exceptval(-1)
    def read(self) -> cython.int:
        words: SharedWords = self.words
        at: cython.ulonglong = self.records_at + (self.tail & self.mask) * RECORD_WORDS
        index: cython.int
        for index in range(8):
            self.record[index] = words.load(at + index)
        if self.record[7] != self.tail + 1:
            raise RingCorrupt(f"record {self.tail} of a ring is numbered {self.record[7]}")
        return 0

    def peek(self):
        self.read()
        return tuple([self.record[index] for index in range(8)])

    @cython.ccall
    @cython.exceptval(check=False)
    def glance(self) -> cython.ulonglong:
        return self.words.load(self.records_at + (self.tail & self.mask) * RECORD_WORDS)

    @cython.ccall
    @cython.exceptval(check=False)
    def take(self) -> cython.void:
        fence()
        self.tail_words.store(self.tail_at, self.tail + 1)
        self.tail += 1

    def close(self):
        pass


@cython.final
@cython.cclass
class NumberRingWriter:
    words: SharedWords
    head_at: cython.ulonglong
    numbers_at: cython.ulonglong
    mask: cython.ulonglong
    head = cython.declare(cython.ulonglong, visibility="public")

    def __init__(self, place):
        self.words = place.words
        self.head_at, self.numbers_at, self.mask = place.head_at, place.records_at, place.capacity - 1
        self.head = self.words.load(self.head_at)

    @cython.ccall
    @cython.exceptval(check=False)
    def push(self, number: cython.ulonglong) -> cython.void:
        self.words.store(self.numbers_at + (self.head & self.mask), number)
        fence_stores()
        self.head += 1
        self.words.store(self.head_at, self.head)

    def close(self):
        pass


@cython.final
@cython.cclass
class ReferenceList:
    """References in the order in which they were entered, each with a number."""

    owner: cython.ulonglong[::1]
    value: cython.ulonglong[::1]
    before: cython.ulonglong[::1]
    after: cython.ulonglong[::1]
    number: cython.ulonglong
    count: cython.ulonglong
    first: cython.ulonglong
    last: cython.ulonglong

    def __init__(self, books, number):
        self.owner, self.value, self.before, self.after = books.places
        self.number = number
        self.count = 0
        self.first = self.last = NONE

    @cython.cfunc
    @cython.exceptval(check=False)
    @cython.inline
    def has(self, reference: cython.ulonglong) -> cython.bint:
        return reference < cython.cast(cython.ulonglong, self.owner.shape[0]) and self.owner[reference] == self.number

    @cython.cfunc
    @cython.exceptval(check=False)
    def append(self, reference: cython.ulonglong, value: cython.ulonglong) -> cython.void:
        self.owner[reference] = self.number
        self.value[reference] = value
        self.before[reference] = self.last
        self.after[reference] = NONE
        if self.last == NONE:
            self.first = reference
        else:
            self.after[self.last] = reference
        self.last = reference
        self.count += 1

    @cython.cfunc
    @cython.exceptval(check=False)
    def remove(self, reference: cython.ulonglong) -> cython.ulonglong:
        before: cython.ulonglong = self.before[reference]
        after: cython.ulonglong = self.after[reference]
        if before == NONE:
            self.first = after
        else:
            self.after[before] = after
        if after == NONE:
            self.last = before
        else:
            self.before[after] = before
        self.owner[reference] = 0
        self.count -= 1
        return self.value[reference]

    def __len__(self):
        return self.count

    def __contains__(self, reference):
        return self.has(reference)

    def __iter__(self):
        found = []
        reference: cython.ulonglong = self.first
        while reference != NONE:
            found.append(reference)
            reference = self.after[reference]
        return iter(found)

    def __getitem__(self, reference):
        if not self.has(reference):
            raise KeyError(reference)
        return self.value[reference]

    def __setitem__(self, reference, value):
        if self.has(reference):
            self.value[reference] = value
        else:
            self.append(reference, value)

    def __delitem__(self, reference):
        self.pop(reference)

    def pop(self, reference):
        if not self.has(reference):
            raise KeyError(reference)
        return self.remove(reference)

    def items(self):
        return [(reference, self.value[reference]) for reference in self]

    def values(self):
        return [self.value[reference] for reference in self]

    def clear(self):
        while self.count:
            self.remove(self.first)

    def move_to_end(self, reference, last=True):
        value = self.pop(reference)
        if last:
            self.append(reference, value)
            return
        entries = self.items()
        self.clear()
        self.append(reference, value)
        for other, number in entries:
            self.append(other, number)


class PureBooks:
    """Makes the parts of slots, links, channels and subscriptions."""

    is_wanting = True

    def __init__(self, references):
        self.places = tuple([array("Q", bytes(8 * references)) for _ in range(4)])
        self.lists = 0

    def of(self, part):
        return part

    def enter(self, subscription):
        pass

    def queue(self):
        self.lists += 1
        return ReferenceList(self, self.lists)

    references = queue

    def numbers(self, values):
        return array("Q", values)

    def reader(self, place):
        return RingReader(place)

    def writer(self, place):
        return RingWriter(place)

    def number_writer(self, place):
        return NumberRingWriter(place)


@cython.cclass
class SubscriptionBase:
    index = cython.declare(cython.ulonglong, visibility="public")
    at = cython.declare(cython.ulonglong, visibility="public")
    slot = cython.declare(cython.ulonglong, visibility="public")
    declaration = cython.declare(cython.ulonglong, visibility="public")
    newest_only = cython.declare(cython.bint, visibility="public")
    queued_reference: cython.ulonglong

    def __cinit__(self):
        self.queued_reference = NONE

    @property
    def queued(self):
        return None if self.queued_reference == NONE else self.queued_reference

    @queued.setter
    def queued(self, value):
        self.queued_reference = NONE if value is None else value


@cython.cclass
class ChannelBase:
    index = cython.declare(cython.ulonglong, visibility="public")
    at = cython.declare(cython.ulonglong, visibility="public")
    subscriptions = cython.declare(tuple, visibility="public")


@cython.cclass
class LinkBase:
    slot = cython.declare(cython.ulonglong, visibility="public")
    source = cython.declare(cython.ulonglong, visibility="public")
    credit = cython.declare(cython.ulonglong, visibility="public")
    awaited_freed = cython.declare(cython.ulonglong, visibility="public")
    wanted_release = cython.declare(cython.ulonglong, visibility="public")
    ready = cython.declare(cython.bint, visibility="public")
    has_ended = cython.declare(cython.bint, visibility="public")
    is_to_post: cython.bint
    outbound = cython.declare(RingReader, visibility="public")
    inbound = cython.declare(RingWriter, visibility="public")
    freed = cython.declare(NumberRingWriter, visibility="public")
    channels = cython.declare(dict, visibility="public")
    pushed = cython.declare(ReferenceList, visibility="public")
    pinned = cython.declare(ReferenceList, visibility="public")
    in_flight = cython.declare(cython.ulonglong[::1], visibility="public")
    windows = cython.declare(cython.ulonglong[::1], visibility="public")
    wake = cython.declare(object, visibility="public")
    head_seen = cython.declare(cython.ulonglong, visibility="public")
    _first_record = cython.declare(cython.ulonglong, visibility="public")


@cython.cclass
class SlotBase:
    index = cython.declare(cython.ulonglong, visibility="public")
    at = cython.declare(cython.ulonglong, visibility="public")
    queue_messages = cython.declare(cython.ulonglong, visibility="public")
    queue_bytes = cython.declare(cython.ulonglong, visibility="public")
    credit = cython.declare(cython.ulonglong, visibility="public")
    waiting = cython.declare(ReferenceList, visibility="public")
    waiting_bytes = cython.declare(cython.ulonglong, visibility="public")
    link = cython.declare(LinkBase, visibility="public")
    is_outdated: cython.bint


@cython.cclass
class MembersBase:
    links = cython.declare(tuple, visibility="public")
    have_notices = cython.declare(cython.bint, visibility="public")
    have_changed = cython.declare(cython.bint, visibility="public")


@cython.final
@cython.cclass
class Ledger:
    """Handles, references and the counters of subscriptions; the rows are read where they lie."""

    words: SharedWords
    handles_at: cython.ulonglong
    references_at: cython.ulonglong
    handle_rows: cython.ulonglong
    reference_rows: cython.ulonglong
    free_handles: cython.ulonglong[::1]
    free_references: cython.ulonglong[::1]
    free_handle_count: cython.ulonglong
    free_reference_count: cython.ulonglong
    _holders: cython.ulonglong[::1]
    subscriptions = cython.declare(list, visibility="public")
    blocks: "FreedBlocks"
    give_back = cython.declare(object, visibility="public")

    def __init__(self, tables, subscriptions):
        self.words = tables.words
        self.handle_rows, self.reference_rows = tables.sizes.handles, tables.sizes.references
        self.handles_at, self.references_at = tables.handle(0), tables.reference(0)
        self.free_handles = array("Q", range(tables.sizes.handles - 1, -1, -1))
        self.free_references = array("Q", range(tables.sizes.references - 1, -1, -1))
        self.free_handle_count, self.free_reference_count = self.handle_rows, self.reference_rows
        self._holders = array("Q", bytes(8 * self.handle_rows))
        self.subscriptions = subscriptions

    def set_blocks(self, blocks):
        self.blocks = blocks

    @cython.cfunc
    @cython.exceptval(check=False)
    @cython.inline
    def handle_row(self, index: cython.ulonglong) -> cython.ulonglong:
        return self.handles_at + index * HANDLE_WORDS

    @cython.cfunc
    @cython.exceptval(check=False)
    @cython.inline
    def reference_row(self, index: cython.ulonglong) -> cython.ulonglong:
        return self.references_at + index * REFERENCE_WORDS

    @cython.cfunc
    @cython.exceptval(check=False)
    @cython.inline
    def message_of(self, reference: cython.ulonglong) -> cython.ulonglong:
        return self.words.load(self.reference_row(reference) + REFERENCE_HANDLE)

    @cython.cfunc
    @cython.inline
    def subscription_of(self, reference: cython.ulonglong) -> SubscriptionBase:
        return self.subscriptions[self.words.load(self.reference_row(reference) + REFERENCE_SUBSCRIPTION)]

    @cython.cfunc
    @cython.exceptval(check=False)
    def has_room_for(self, references: cython.ulonglong) -> cython.bint:
        return self.free_handle_count != 0 and self.free_reference_count >= references

    def has_room(self, references):
        return self.has_room_for(references)

    @cython.cfunc
    @cython.exceptval(check=False)
    def enter(self, sequence: cython.ulonglong, source: cython.ulonglong, offset: cython.ulonglong,
              size: cython.ulonglong, channel: cython.ulonglong, stamp_ns: cython.ulonglong,
              block: cython.ulonglong, record: cython.ulonglong, publisher_routed: cython.ulonglong,
              channel_messages: cython.ulonglong, channel_bytes: cython.ulonglong) -> cython.ulonglong:
        self.free_handle_count -= 1
        index: cython.ulonglong = self.free_handles[self.free_handle_count]
        words: SharedWords = self.words
        at: cython.ulonglong = self.handle_row(index)
        words.store(at + HANDLE_RECORD, NO_RECORD)
        words.store(at + HANDLE_SOURCE, source)
        words.store(at + HANDLE_OFFSET, offset)
        words.store(at + HANDLE_BYTES, size)
        words.store(at + HANDLE_CHANNEL, channel)
        words.store(at + HANDLE_STAMP_NS, stamp_ns)
        words.store(at + HANDLE_BLOCK, block)
        words.store(at + HANDLE_PUBLISHER_ROUTED, publisher_routed)
        words.store(at + HANDLE_CHANNEL_MESSAGES, channel_messages)
        words.store(at + HANDLE_CHANNEL_BYTES, channel_bytes)
        words.store(at + HANDLE_RECORD, record)
        words.store(at + HANDLE_SEQUENCE, sequence)
        return index

    def open_handle(self, handle, record, publisher_routed, channel_messages, channel_bytes):
        sequence, source, offset, size, channel, stamp_ns, block = handle
        return self.enter(sequence, source, offset, size, channel, stamp_ns, block, record, publisher_routed,
                          channel_messages, channel_bytes)

    @cython.ccall
    @cython.exceptval(check=False)
    def close_handle(self, index: cython.ulonglong) -> cython.void:
        self.words.store(self.handle_row(index), 0)
        self.free_handles[self.free_handle_count] = index
        self.free_handle_count += 1

    @cython.cfunc
    @cython.exceptval(check=False)
    def open_reference(self, subscription: SubscriptionBase, handle: cython.ulonglong) -> cython.ulonglong:
        words: SharedWords = self.words
        sequence: cython.ulonglong = words.load(self.handle_row(handle))
        self.free_reference_count -= 1
        index: cython.ulonglong = self.free_references[self.free_reference_count]
        at: cython.ulonglong = self.reference_row(index)
        routed: cython.ulonglong = words.load(subscription.at + SUBSCRIPTION_ROUTED) + 1
        words.store(at + 1, sequence)
        words.store(at + 2, handle)
        words.store(at + 3, subscription.index)
        words.store(at + 4, 0)
        words.store(at, OUTCOME_HELD | routed << 8)
        words.store(subscription.at + SUBSCRIPTION_ROUTED, routed)
        self._holders[handle] += 1
        return index

    def open_late_reference(self, subscription, handle):
        return self.open_reference(subscription, handle)

    def open_references(self, subscriptions, handle):
        opened = []
        for subscription in subscriptions:
            opened.append((subscription, self.open_late_reference(subscription, handle)))
            self.words.store(subscription.at + SUBSCRIPTION_LAST_SEQUENCE, self.words.load(self.handle_row(handle)))
        return opened

    def has_free_reference(self):
        return self.free_reference_count != 0

    def reference(self, index):
        at = self.reference_row(index)
        if not self.words.load(at):
            raise KeyError(f"reference {index} is not live")
        return self.words.load(at + 1), self.words.load(at + 2), self.subscription_of(index)

    def handle(self, index):
        at = self.handle_row(index)
        words = self.words
        return Handle(words.load(at), *[words.load(at + HANDLE_SOURCE + column) for column in range(6)])

    @cython.ccall
    @cython.exceptval(check=False)
    def mark_pushed(self, index: cython.ulonglong, record: cython.ulonglong) -> cython.void:
        self.words.store(self.reference_row(index) + REFERENCE_PUSHED_AT, record + 1)

    def mark_waiting(self, index):
        self.words.store(self.reference_row(index) + REFERENCE_PUSHED_AT, 0)

    @cython.ccall
    def count(self, index: cython.ulonglong, outcome: cython.ulonglong):
        words: SharedWords = self.words
        at: cython.ulonglong = self.subscription_of(index).at + SUBSCRIPTION_ROUTED + outcome - 1
        nth: cython.ulonglong = words.load(at) + 1
        words.store(self.reference_row(index), outcome | nth << 8)
        words.store(at, nth)

    @cython.ccall
    def close_reference(self, index: cython.ulonglong):
        handle: cython.ulonglong = self.message_of(index)
        self.words.store(self.reference_row(index), OUTCOME_FREE)
        self.free_references[self.free_reference_count] = index
        self.free_reference_count += 1
        self._holders[handle] -= 1
        if self._holders[handle] == 0:
            self.blocks.give_back(handle)

    @cython.ccall
    def finish(self, index: cython.ulonglong, outcome: cython.ulonglong):
        self.count(index, outcome)
        self.close_reference(index)

    def holders(self, handle):
        return self._holders[handle]

    def size_of(self, handle):
        return self.words.load(self.handle_row(handle) + HANDLE_BYTES)

    def stamp_ns_of(self, handle):
        return self.words.load(self.handle_row(handle) + HANDLE_STAMP_NS)

    def handle_of(self, reference):
        return self.message_of(reference)

    def _held(self):
        return [row for row in range(self.handle_rows) if self._holders[row]]

    def live_of_sources(self):
        return Counter([self.words.load(self.handle_row(row) + HANDLE_SOURCE) & SOURCE_OF_INCARNATION for row in self._held()])

    def live_of(self, source):
        rows = [row for row in self._held() if self.words.load(self.handle_row(row) + HANDLE_SOURCE) & SOURCE_OF_INCARNATION == source]
        return sorted(rows, key=self._sequence_of)

    def _sequence_of(self, row):
        return self.words.load(self.handle_row(row))

    def live_handles(self):
        return [index for index in range(self.handle_rows) if self.words.load(self.handle_row(index))]

    def used_handles(self):
        return [index for index in range(self.handle_rows) if self.words.load(self.handle_row(index) + HANDLE_SOURCE)]

    def live_references(self):
        return [index for index in range(self.reference_rows) if self.words.load(self.reference_row(index))]

    def read_handle(self, index):
        at, words = self.handle_row(index), self.words
        return HandleRow(self.handle(index), words.load(at + HANDLE_RECORD), words.load(at + HANDLE_PUBLISHER_ROUTED),
                         words.load(at + HANDLE_CHANNEL_MESSAGES), words.load(at + HANDLE_CHANNEL_BYTES))

    def read_reference(self, index):
        at, words = self.reference_row(index), self.words
        state = words.load(at)
        return ReferenceRow(Outcome(state & 0xFF), state >> 8, words.load(at + 1), words.load(at + 2),
                            words.load(at + 3), words.load(at + 4))

    def adopt_handles(self, found):
        left = [row for row in self.free_handles[: self.free_handle_count] if row not in found]
        self.free_handle_count = len(left)
        for place, row in enumerate(left):
            self.free_handles[place] = row

    def adopt_references(self, found):
        for reference in found.values():
            self._holders[reference[1]] += 1
        left = [row for row in self.free_references[: self.free_reference_count] if row not in found]
        self.free_reference_count = len(left)
        for place, row in enumerate(left):
            self.free_references[place] = row

    def is_live(self, handle):
        return self.words.load(self.handle_row(handle)) != 0

    def claimants(self, handle):
        rows = self.live_references()
        return {self.words.load(self.reference_row(row) + 3) for row in rows if self.message_of(row) == handle}

    def was_claimed(self, subscription, sequence):
        return self.words.load(subscription.at + SUBSCRIPTION_LAST_SEQUENCE) >= sequence


@cython.final
@cython.cclass
class FreedBlocks:
    words: SharedWords
    ledger: Ledger
    slots: list
    members: object
    dead_sources = cython.declare(dict, visibility="public")

    def __init__(self, words, ledger, slots, members):
        self.words, self.ledger, self.slots, self.members = words, ledger, slots, members
        self.dead_sources = {}

    @property
    def are_awaited(self):
        return any([link.awaited_freed for link in self.members.links])

    @cython.ccall
    def give_back(self, index: cython.ulonglong):
        row: cython.ulonglong = self.ledger.handle_row(index)
        source: cython.ulonglong = self.words.load(row + HANDLE_SOURCE) & SOURCE_OF_INCARNATION
        slot: SlotBase = self.slots[source & SOURCE_SLOT]
        link: LinkBase = slot.link
        if link is not None and source == link.source:
            self.free(link, self.words.load(row + HANDLE_BLOCK))
        self.ledger.close_handle(index)
        if self.dead_sources and source in self.dead_sources:
            self._end_of(source)

    def _end_of(self, source):
        from robbie_mp.bus.transport import layout
        self.dead_sources[source] -= 1
        if not self.dead_sources[source]:
            del self.dead_sources[source]
            slot, _, incarnation = layout.unpack_source(source)
            self.members.announce_gone((slot, incarnation))

    @cython.ccall
    def free(self, link: LinkBase, block: cython.ulonglong):
        link.freed.push(block)
        if link.awaited_freed != 0 and link.awaited_freed <= link.freed.head:
            self.await_total(link, 0)

    def on_wait_freed(self, _slot, link, record):
        self.await_total(link, record[1])

    @cython.ccall
    def await_total(self, link: LinkBase, total: cython.ulonglong):
        waits: cython.bint = total > link.freed.head
        link.awaited_freed = total if waits else 0
        if not waits:
            link.wake()

    def mark_dead(self, slot, incarnation):
        from robbie_mp.bus.transport import layout
        source = layout.pack_source(slot, 0, incarnation)
        if live := len(self.ledger.live_of(source)):
            self.dead_sources[source] = live
        else:
            self.members.announce_gone((slot, incarnation))
        if self.slots[slot].link is None:
            self.words.store(self.slots[slot].at + layout.PUBLISHER_LINKED, 0)


@cython.final
@cython.cclass
class Queues:
    words: SharedWords
    ledger: Ledger
    slots = cython.declare(list, visibility="public")
    holds_posts = cython.declare(cython.bint, visibility="public")
    to_post = cython.declare(list, visibility="public")
    outdated: list

    def __init__(self, words, ledger, slots):
        self.words, self.ledger, self.slots = words, ledger, slots
        self.to_post, self.outdated = [], []

    @cython.ccall
    def note_post(self, link: LinkBase):
        if not link.is_to_post:
            link.is_to_post = True
            self.to_post.append(link)

    @cython.ccall
    def outdate(self, slot: SlotBase):
        if not slot.is_outdated:
            slot.is_outdated = True
            self.outdated.append(slot)

    @cython.cfunc
    @cython.exceptval(check=False)
    def may_follow(self, subscription: SubscriptionBase, source: cython.ulonglong, size: cython.ulonglong,
                   link: LinkBase) -> cython.bint:
        if subscription.newest_only or link.pushed.count >= link.credit:
            return False
        publisher: cython.ulonglong = source & SOURCE_SLOT
        in_flight: cython.ulonglong = link.in_flight[publisher]
        return in_flight == 0 or in_flight + size <= link.windows[publisher]

    @cython.cfunc
    def add_message(self, subscription: SubscriptionBase, reference: cython.ulonglong, row: cython.ulonglong):
        slot: SlotBase = self.slots[subscription.slot]
        link: LinkBase = slot.link
        size: cython.ulonglong = self.words.load(row + HANDLE_BYTES)
        if (
            link is not None
            and link.ready
            and slot.waiting.count == 0
            and (link.pushed.count == 0
                 or self.may_follow(subscription, self.words.load(row + HANDLE_SOURCE), size, link))
        ):
            self.push(subscription, reference, row, link)
            if self.holds_posts:
                self.note_post(link)
            else:
                link.wake()
        else:
            self.queue(slot, subscription, reference, size)
        self.outdate(slot)

    def add(self, subscription, reference, handle):
        self.add_message(subscription, reference, self.ledger.handle_row(self.ledger.message_of(reference)))

    @cython.cfunc
    def queue(self, slot: SlotBase, subscription: SubscriptionBase, reference: cython.ulonglong,
              size: cython.ulonglong):
        if subscription.newest_only:
            old: cython.ulonglong = subscription.queued_reference
            if old != NONE:
                self.remove(slot, old)
                self.ledger.finish(old, OUTCOME_REPLACED)
            subscription.queued_reference = reference
        slot.waiting.append(reference, size)
        slot.waiting_bytes += size
        if slot.link is not None and slot.link.ready:
            self.pump(slot, slot.link)
        while slot.waiting.count > 1 and (
            slot.waiting.count > slot.queue_messages or slot.waiting_bytes > slot.queue_bytes
        ):
            oldest: cython.ulonglong = slot.waiting.first
            self.remove(slot, oldest)
            self.ledger.finish(oldest, OUTCOME_DROPPED)

    @cython.ccall
    def remove(self, slot: SlotBase, reference: cython.ulonglong):
        slot.waiting_bytes -= slot.waiting.remove(reference)
        subscription: SubscriptionBase = self.ledger.subscription_of(reference)
        if subscription.queued_reference == reference:
            subscription.queued_reference = NONE

    @cython.ccall
    def pump(self, slot: SlotBase, link: LinkBase):
        ledger: Ledger = self.ledger
        words: SharedWords = self.words
        sent: cython.bint = False
        while slot.waiting.count:
            reference: cython.ulonglong = slot.waiting.first
            subscription: SubscriptionBase = ledger.subscription_of(reference)
            row: cython.ulonglong = ledger.handle_row(ledger.message_of(reference))
            if link.pushed.count and not self.may_follow(
                subscription, words.load(row + HANDLE_SOURCE), words.load(row + HANDLE_BYTES), link
            ):
                break
            self.remove(slot, reference)
            self.push(subscription, reference, row, link)
            sent = True
        if sent:
            self.note_post(link)

    @cython.cfunc
    @cython.exceptval(check=False)
    def push(self, subscription: SubscriptionBase, reference: cython.ulonglong, row: cython.ulonglong,
             link: LinkBase) -> cython.void:
        words: SharedWords = self.words
        inbound: RingWriter = link.inbound
        record: cython.ulonglong = inbound.head
        source: cython.ulonglong = words.load(row + HANDLE_SOURCE)
        size: cython.ulonglong = words.load(row + HANDLE_BYTES)
        link.pushed.append(reference, record)
        link.in_flight[source & SOURCE_SLOT] += size
        self.ledger.mark_pushed(reference, record)
        inbound.push(
            INBOUND_DELIVER | subscription.declaration << DECLARATION_SHIFT
            | words.load(row + HANDLE_CHANNEL) << CHANNEL_SHIFT,
            reference, words.load(row), source, words.load(row + HANDLE_OFFSET), size,
            words.load(row + HANDLE_STAMP_NS),
        )

    def add_late(self, slot, subscription, reference, size):
        if subscription.newest_only:
            if (old := subscription.queued) is not None:
                self.remove(slot, old)
                self.ledger.finish(old, OUTCOME_REPLACED)
            subscription.queued = reference
        sequence = self.ledger.reference(reference)[0]
        later = [other for other in slot.waiting if self.ledger.reference(other)[0] > sequence]
        slot.waiting[reference] = size
        slot.waiting_bytes += size
        for other in later:
            slot.waiting.move_to_end(other)
        self.outdate(slot)

    def trim(self, slot, spared):
        droppable = sorted(slot.waiting, key=lambda reference: reference in spared)
        for reference in droppable[: len(droppable) - 1]:
            if len(slot.waiting) <= slot.queue_messages and slot.waiting_bytes <= slot.queue_bytes:
                return
            self.remove(slot, reference)
            self.ledger.finish(reference, OUTCOME_DROPPED)
            self.outdate(slot)

    def put_back(self, slot, reference):
        _sequence, handle, subscription = self.ledger.reference(reference)
        if subscription.newest_only:
            if subscription.queued is not None:
                self.ledger.finish(reference, OUTCOME_REPLACED)
                return
            subscription.queued = reference
        self.ledger.mark_waiting(reference)
        size = self.ledger.size_of(handle)
        slot.waiting[reference] = size
        slot.waiting.move_to_end(reference, last=False)
        slot.waiting_bytes += size

    @cython.ccall
    @cython.exceptval(check=False)
    def somebody_waits(self) -> cython.bint:
        slot: SlotBase
        for slot in self.slots:
            if slot.waiting.count and slot.link is not None:
                return True
        return False

    @cython.ccall
    def post(self):
        link: LinkBase
        for link in self.to_post:
            link.is_to_post = False
            link.wake()
        self.to_post.clear()

    @cython.ccall
    def end_round(self):
        if self.to_post:
            self.post()
        self.write_figures()

    def is_settled(self):
        return False

    @cython.ccall
    def write_figures(self):
        words: SharedWords = self.words
        slot: SlotBase
        for slot in self.outdated:
            slot.is_outdated = False
            link: LinkBase = slot.link
            at: cython.ulonglong = slot.at + PUBLISHER_WAITING
            words.store(at, slot.waiting.count)
            words.store(at + 1, slot.waiting_bytes)
            words.store(at + 2, link.pushed.count if link is not None else 0)
            words.store(at + 3, link.pinned.count if link is not None else 0)
            if slot.waiting.count > words.load(slot.at + PUBLISHER_WAITING_PEAK):
                words.store(slot.at + PUBLISHER_WAITING_PEAK, slot.waiting.count)
        self.outdated.clear()


@cython.final
@cython.cclass
class MessageFlow:
    words: SharedWords
    message_bytes: cython.ulonglong
    ledger: Ledger
    queues: Queues
    blocks: FreedBlocks
    claims: cython.ulonglong[::1]

    def __init__(self, words, message_bytes, ledger, queues, blocks):
        self.words, self.message_bytes, self.ledger = words, message_bytes, ledger
        self.queues, self.blocks = queues, blocks
        self.claims = array("Q", bytes(8 * 4096))

    @cython.cfunc
    def on_publish(self, slot: SlotBase, link: LinkBase, outbound: RingReader):
        declaration: cython.ulonglong = outbound.record[1]
        source: cython.ulonglong = outbound.record[2]
        offset: cython.ulonglong = outbound.record[3]
        size: cython.ulonglong = outbound.record[4]
        stamp_ns: cython.ulonglong = outbound.record[5]
        block: cython.ulonglong = outbound.record[6]
        channel: ChannelBase = link.channels.get(declaration)
        if channel is None or source & SOURCE_OF_INCARNATION != link.source:
            self._violation(f"it published on declaration {declaration} from source {source:#x}")
        if size > self.message_bytes or offset > WORD_MAX >> 1:
            self._violation(f"it published {size} bytes at offset {offset}")
        subscriptions: tuple = channel.subscriptions
        ledger: Ledger = self.ledger
        if not ledger.has_room_for(len(subscriptions)):
            self._refuse(slot, link, block)
            return
        words: SharedWords = self.words
        sequence: cython.ulonglong = words.load(CORE_LAST_SEQUENCE) + 1
        figures: cython.ulonglong = channel.at
        index: cython.ulonglong = ledger.enter(
            sequence, source, offset, size, channel.index, stamp_ns, block, outbound.tail,
            words.load(slot.at + PUBLISHER_ROUTED) + 1,
            words.load(figures + CHANNEL_MESSAGES) + 1, words.load(figures + CHANNEL_BYTES) + size,
        )
        self.send(slot, channel, index, subscriptions, sequence, size, stamp_ns)

    def _violation(self, text):
        from robbie_mp.bus.core.members import ProtocolViolation
        raise ProtocolViolation(text)

    def route(self, slot, channel, figures, index, handle, subscriptions):
        self.send(slot, channel, index, tuple(subscriptions), handle[0], handle[3], handle[5])

    @cython.cfunc
    def send(self, slot: SlotBase, channel: ChannelBase, index: cython.ulonglong, subscriptions: tuple,
             sequence: cython.ulonglong, size: cython.ulonglong, stamp_ns: cython.ulonglong):
        ledger: Ledger = self.ledger
        words: SharedWords = self.words
        row: cython.ulonglong = ledger.handle_row(index)
        words.store(CORE_LAST_SEQUENCE, sequence)
        count: cython.Py_ssize_t = len(subscriptions)
        nth: cython.Py_ssize_t
        subscription: SubscriptionBase
        for nth in range(count):
            subscription = subscriptions[nth]
            self.claims[nth] = ledger.open_reference(subscription, index)
            words.store(subscription.at + SUBSCRIPTION_LAST_SEQUENCE, sequence)
        for nth in range(count):
            self.queues.add_message(subscriptions[nth], self.claims[nth], row)
        words.store(slot.at + PUBLISHER_ROUTED, words.load(slot.at + PUBLISHER_ROUTED) + 1)
        self.count(channel, size, stamp_ns)
        if count == 0 and ledger._holders[index] == 0:
            self.blocks.give_back(index)

    @cython.cfunc
    @cython.exceptval(check=False)
    def count(self, channel: ChannelBase, size: cython.ulonglong, stamp_ns: cython.ulonglong) -> cython.void:
        words: SharedWords = self.words
        at: cython.ulonglong = channel.at
        messages: cython.ulonglong = words.load(at + CHANNEL_MESSAGES)
        total: cython.ulonglong = words.load(at + CHANNEL_BYTES)
        last_ns: cython.ulonglong = words.load(at + CHANNEL_LAST_STAMP_NS)
        squares: cython.ulonglong = words.load(at + CHANNEL_INTERVALS_SQUARED)
        if last_ns:
            stamp_us: cython.ulonglong = stamp_ns // 1000
            last_us: cython.ulonglong = last_ns // 1000
            interval: cython.ulonglong = stamp_us - last_us if stamp_us >= last_us else last_us - stamp_us
            if interval > 1000000000:
                interval = 1000000000
            squares += interval * interval
        words.store(at + CHANNEL_MESSAGES, messages + 1)
        words.store(at + CHANNEL_BYTES, total + size)
        words.store(at + CHANNEL_LAST_STAMP_NS, stamp_ns)
        words.store(at + CHANNEL_INTERVALS_SQUARED, squares)

    def _refuse(self, slot, link, block):
        from robbie_mp.bus.transport import layout
        words, at = self.words, slot.at
        nth = words.load(at + layout.PUBLISHER_REFUSED) + 1
        words.store(at + layout.PUBLISHER_REFUSED_NTH, nth)
        words.store(at + layout.PUBLISHER_REFUSED_INCARNATION, link.incarnation)
        words.store(at + layout.PUBLISHER_REFUSED_RECORD, link.outbound.tail)
        words.store(at + layout.PUBLISHER_REFUSED, nth)
        self.blocks.free(link, block)

    @cython.cfunc
    @cython.exceptval(check=False)
    def is_in(self, entries: ReferenceList, reference: cython.ulonglong, sequence: cython.ulonglong) -> cython.bint:
        ledger: Ledger = self.ledger
        return entries.has(reference) and self.words.load(
            ledger.reference_row(reference) + REFERENCE_SEQUENCE
        ) == sequence

    @cython.cfunc
    @cython.exceptval(check=False)
    def take_back(self, link: LinkBase, reference: cython.ulonglong) -> cython.void:
        row: cython.ulonglong = self.ledger.handle_row(self.ledger.message_of(reference))
        link.pushed.remove(reference)
        link.in_flight[self.words.load(row + HANDLE_SOURCE) & SOURCE_SLOT] -= self.words.load(row + HANDLE_BYTES)

    def on_done(self, slot, link, record):
        self.done(slot, link, record[1], record[2])

    @cython.cfunc
    def done(self, slot: SlotBase, link: LinkBase, reference: cython.ulonglong, sequence: cython.ulonglong):
        if not self.is_in(link.pushed, reference, sequence):
            if link.is_repeated():
                return
            self._violation(f"it is done with reference {reference}, which it does not have")
        self.take_back(link, reference)
        link.pinned.append(reference, 0)
        self.ledger.count(reference, OUTCOME_DELIVERED)
        self.queues.pump(slot, link)
        self.queues.outdate(slot)

    @cython.cfunc
    def on_release(self, slot: SlotBase, link: LinkBase, reference: cython.ulonglong, sequence: cython.ulonglong):
        if self.is_in(link.pushed, reference, sequence):
            self.take_back(link, reference)
            self.ledger.finish(reference, OUTCOME_DELIVERED)
        elif self.is_in(link.pinned, reference, sequence):
            link.pinned.remove(reference)
            self.ledger.close_reference(reference)
        elif not link.is_repeated():
            self._violation(f"it released reference {reference}, which it does not have")
        self.queues.pump(slot, link)
        self.queues.outdate(slot)


@cython.final
@cython.cclass
class Round:
    """The loop over the rings."""

    flow: MessageFlow
    queues: Queues
    slots: list
    unfinished = cython.declare(list, visibility="public")
    wanting: cython.bint
    next_look_ns: cython.longlong
    stopping = cython.declare(cython.bint, visibility="public")
    per_turn: cython.longlong
    links: tuple

    def __init__(self, flow, queues, slots):
        self.flow, self.queues, self.slots = flow, queues, slots
        self.unfinished = []
        self.links = ()
        self.wanting = True
        self.next_look_ns = 0

    @cython.ccall
    def run(self, router, links: tuple, per_turn: cython.longlong = 16):
        self.per_turn = per_turn
        link: LinkBase
        head: cython.ulonglong
        turns: list = []
        releasing: list = []
        for link in links:
            head = link.outbound.words.load(link.outbound.head_at)
            if head != link.head_seen:
                link.head_seen = head
                turns.append(link)
        if self.unfinished:
            turns = list(dict.fromkeys((*turns, *self.unfinished)))
            self.unfinished = []
        for link in turns:
            if not link.has_ended and link.outbound.glance() == OUTBOUND_RELEASE:
                releasing.append(link)
            else:
                self.serve(router, link)
        for link in releasing:
            self.serve(router, link)
        self.queues.end_round()
        return bool(self.unfinished)

    @cython.cfunc
    def serve(self, router, link: LinkBase):
        if link.has_ended:
            return
        try:
            waiting: cython.longlong = link.outbound.waiting()
            if waiting > self.per_turn:
                self.unfinished.append(link)
                waiting = self.per_turn
            self.receive(router, link, waiting, 0)
        except Exception as error:
            router._fault(link, error)

    @cython.ccall
    def receive(self, router, link: LinkBase, records: cython.longlong, more: cython.longlong):
        outbound: RingReader = link.outbound
        slot: SlotBase = self.slots[link.slot]
        queues: Queues = self.queues
        flow: MessageFlow = self.flow
        left: cython.longlong = records + more
        kind: cython.ulonglong
        while left > more:
            left -= 1
            queues.holds_posts = left != 0
            outbound.read()
            kind = outbound.record[0]
            if kind == OUTBOUND_PUBLISH:
                flow.on_publish(slot, link, outbound)
            elif kind == OUTBOUND_RELEASE:
                flow.on_release(slot, link, outbound.record[1], outbound.record[2])
            else:
                router._receive_rare(link, slot, outbound.peek())
            outbound.take()
        if queues.to_post and not more:
            queues.post()

    @cython.ccall
    @cython.exceptval(check=False)
    def before_sleep(self, links: tuple, books) -> cython.bint:
        """The part of Router.before_sleep without notices."""
        link: LinkBase
        slot: SlotBase
        awaited: cython.bint = False
        look_again: cython.bint = False
        for link in links:
            awaited |= link.awaited_freed != 0
        if not awaited and not self.wanting and not self.queues.somebody_waits():
            return False
        self.wanting = False
        for link in links:
            slot = self.slots[link.slot]
            waited_for: cython.bint = slot.waiting.count != 0 or (
                awaited and (link.pushed.count != 0 or link.pinned.count != 0)
            )
            look_again |= self.want_release(link, waited_for)
            self.wanting |= waited_for
        if look_again:
            fence()
        return look_again

    @cython.cfunc
    @cython.exceptval(check=False)
    def want_release(self, link: LinkBase, is_wanted: cython.bint) -> cython.bint:
        pushed: ReferenceList = link.pushed
        end: cython.ulonglong = pushed.value[pushed.last] + 1 if pushed.count != 0 else link.inbound.head
        want: cython.ulonglong = 0
        if is_wanted:
            want = end - pushed.count // 2
            if want == 0:
                want = 1
        if want == link.wanted_release:
            return False
        link.inbound.words.store(IN_WANT_RELEASE, want)
        link.wanted_release = want
        return is_wanted

    def work(self, router, words: SharedWords, watch, process, wait, timeout_s, monotonic_ns):
        """Route until the process is told to stop."""
        members: MembersBase = router._members
        now_ns: cython.longlong
        books = router._books
        while not self.stopping:
            now_ns = monotonic_ns()
            words.store(CORE_HEARTBEAT_NS, now_ns)
            if now_ns >= self.next_look_ns:
                if watch.look(now_ns):
                    raise SystemExit("no progress")
                self.next_look_ns = watch.next_look_ns
            if self.run(router, members.links):
                continue
            if members.have_changed or members.have_notices:
                if router.before_sleep():
                    continue
            elif self.before_sleep(members.links, books):
                continue
            words.store(CORE_WAKEUPS, words.load(CORE_WAKEUPS) + 1)
            wait(timeout_s)
