# The books of the core as Python types, on which the Python of robbie_mp/bus/core works.
#
# Slot, Link, Subscription and Channel are bases of the Python classes of these names: they only change where
# the attributes lie that C needs. The containers have as much of the interface of dict and list as the core
# uses.
cdef extern from "layout.h":
    enum: CORE_HEARTBEAT_NS, CORE_WAKEUPS, DECLARATION_COUNT
    enum: HANDLE_WORDS, PUBLISHER_WORDS, REFERENCE_WORDS, SUBSCRIPTION_WORDS

cdef extern from "router.h":
    const uint32_t NO_REFERENCE
    struct place_in_list:
        uint64_t value
        uint32_t after
    struct reference_list:
        place_in_list *places
        uint64_t references, count
        uint32_t first
    void list_init(reference_list *list, place_in_list *places, uint64_t references)
    void list_clear(reference_list *list)
    void list_forget(const reference_list *list)
    bint list_has(const reference_list *list, uint64_t reference)
    void list_append(reference_list *list, uint32_t reference, uint64_t value)
    uint64_t list_remove(reference_list *list, uint32_t reference)
    void list_move_to_front(reference_list *list, uint32_t reference)

    struct free_rows:
        uint32_t *rows
        uint64_t count, capacity
    struct subscription_row "subscription":
        uint64_t index, at, slot, declaration
        bint newest_only
        uint32_t queued
    struct channel_row "channel":
        uint64_t index, at, subscription_count, paced_sequence
        subscription_row **subscriptions
        uint32_t paced_reference
    struct link_row "link":
        void *owner
        uint64_t slot, source, credit, awaited_freed, wanted_release, head_seen
        bint ready, has_ended, paces
        ring_reader *outbound
        ring_writer *inbound
        ring_writer *freed
        channel_row **channels
        reference_list *pushed
        reference_list *pinned
        uint64_t *in_flight
        uint64_t *windows
    struct slot_row "slot":
        uint64_t index, at, queue_messages, queue_bytes, waiting_bytes
        reference_list *waiting
        link_row *link
        bint yields
    struct books_of_core "books":
        shared_word *words
        shared_word *handle_rows
        shared_word *reference_rows
        uint64_t slot_count, subscription_count, handle_count, reference_count, link_count
        free_rows *free_handles
        free_rows *free_references
        uint64_t *holders
        place_in_list *places
        slot_row **slots
        link_row **links
        subscription_row **subscriptions
        bint is_wanting
    struct round_of_turns "round":
        link_row **links
        link_row **releasing
        link_row **unfinished
        uint64_t unfinished_count, left
    struct router_of_books "router":
        round_of_turns round
        books_of_core *books
        uint64_t message_bytes
        uint32_t *claims
        void (*wake)(void *context, link_row *link) except *
        bint is_special
    void outdate(books_of_core *books, slot_row *slot)
    void note_post(books_of_core *books, link_row *link)
    bint somebody_waits(const books_of_core *books)
    void begin_round(router_of_books *router)
    void post(router_of_books *router) except *

cdef extern from *:
    """
    GUARDED(try_to_write_figures, (struct books *books), write_figures(books))
    GUARDED(before_a_sleep, (struct books *books, bool *again), *again = before_sleep(books))
    GUARDED(try_to_serve, (struct router *router, struct link *link, uint64_t records, uint64_t *handled),
            *handled = serve(router, link, records))
    GUARDED(go_on_with_round, (struct router *router, uint64_t records, struct link **link),
            *link = serve_round(router, records))
    """
    int try_to_write_figures(books_of_core *books) except -1
    int before_a_sleep(books_of_core *books, c_bool *again) except -1
    int try_to_serve(router_of_books *router, link_row *link, uint64_t records, uint64_t *handled) except -1
    int go_on_with_round(router_of_books *router, uint64_t records, link_row **link) except -1


cdef void *zeros(uint64_t count, size_t size) except NULL:
    """Return memory for items, and for one more, so that there always is some."""
    cdef void *memory = PyMem_Calloc(count + 1, size)
    if memory == NULL:
        raise MemoryError
    return memory


cdef class Numbers:
    """8-byte numbers in a buffer of Python, such as an array of type 'Q'."""

    cdef Py_buffer buffer
    cdef uint64_t *numbers
    cdef uint64_t count

    def __cinit__(self, memory):
        PyObject_GetBuffer(memory, &self.buffer, PyBUF_WRITABLE)
        if <size_t>self.buffer.buf % sizeof(uint64_t) or self.buffer.len % sizeof(uint64_t):
            raise ValueError("numbers must have 8 bytes each")
        self.numbers = <uint64_t *>self.buffer.buf
        self.count = self.buffer.len // sizeof(uint64_t)

    def __dealloc__(self):
        PyBuffer_Release(&self.buffer)


cdef class FreeRows:
    """Free rows of a table; the last one is taken next."""

    cdef free_rows rows

    def __cinit__(self, uint64_t count):
        if count >= NO_REFERENCE:
            raise ValueError("rows must be fewer than 2^32 - 1")
        self.rows.rows = <uint32_t *>zeros(count, sizeof(uint32_t))
        self.rows.count = self.rows.capacity = count
        for index in range(count):
            self.rows.rows[index] = count - 1 - index

    def __dealloc__(self):
        PyMem_Free(self.rows.rows)

    def __len__(self):
        return self.rows.count

    def __getitem__(self, Py_ssize_t index):
        if index < 0:
            index += self.rows.count
        if not 0 <= index < <Py_ssize_t>self.rows.count:
            raise IndexError("no such row")
        return self.rows.rows[index]

    def pop(self):
        """Take the row that was freed last."""
        if self.rows.count == 0:
            raise IndexError("no row is free")
        self.rows.count -= 1
        return self.rows.rows[self.rows.count]

    def append(self, number):
        """Free a row."""
        cdef uint64_t row = word(number)
        if row >= self.rows.capacity or self.rows.count >= self.rows.capacity:
            raise IndexError("there is no such row, or it is free already")
        self.rows.rows[self.rows.count] = row
        self.rows.count += 1

    def clear(self):
        """Let no row be free."""
        self.rows.count = 0


@cython.no_gc_clear  # it must leave its list while the books are still there
cdef class References:
    """References in order, each with a number; made by Books.references()."""

    cdef reference_list list
    cdef Books books

    def __cinit__(self, Books books not None):
        list_init(&self.list, books.books.places, books.books.reference_count)
        self.books = books

    def __dealloc__(self):
        if self.books is not None:
            list_forget(&self.list)  # a dead core may have left it half changed

    cdef uint32_t known(self, key) except? NO_REFERENCE:
        """Return the number of a reference that is in the list."""
        cdef uint64_t reference = word(key)
        if not list_has(&self.list, reference):
            raise KeyError(key)
        return reference

    def __len__(self):
        return self.list.count

    def __contains__(self, key):
        return list_has(&self.list, word(key))

    def __getitem__(self, key):
        return self.list.places[self.known(key)].value

    def __setitem__(self, key, number):
        cdef uint64_t reference = word(key), value = word(number)
        if reference >= self.list.references:
            raise KeyError(key)
        if list_has(&self.list, reference):
            self.list.places[reference].value = value  # it keeps its place
        else:
            list_append(&self.list, reference, value)

    def __delitem__(self, key):
        list_remove(&self.list, self.known(key))

    def __iter__(self):
        return ReferencesIterator(self)

    def pop(self, key):
        """Take a reference out; return its number."""
        return list_remove(&self.list, self.known(key))

    def clear(self):
        """Take all out."""
        list_clear(&self.list)

    def items(self):
        """List the references, each with its number."""
        return [(key, self.list.places[key].value) for key in <list>self.keys()]

    def values(self):
        """List the numbers."""
        return [self.list.places[key].value for key in <list>self.keys()]

    def keys(self):
        """List the references."""
        made = []
        cdef uint32_t at = self.list.first
        while at != NO_REFERENCE:
            made.append(at)
            at = self.list.places[at].after
        return made

    def move_to_end(self, key, bint last=True):
        """Move a reference to the end, or to the front."""
        cdef uint32_t reference = self.known(key)
        if last:
            list_append(&self.list, reference, self.list.places[reference].value)
        else:
            list_move_to_front(&self.list, reference)


cdef class ReferencesIterator:
    """Iterates over references; Cython's generators would lose references to their type."""

    cdef References references
    cdef uint32_t following

    def __cinit__(self, References references not None):
        self.references = references
        self.following = references.list.first

    def __iter__(self):
        return self

    def __next__(self):
        cdef uint32_t at = self.following
        if at == NO_REFERENCE:
            raise StopIteration
        if not list_has(&self.references.list, at):
            raise RuntimeError("the references changed during the iteration")
        self.following = self.references.list.places[at].after
        return at


cdef class Row:
    """What has a struct in C, whose fields are its attributes."""

    cdef char *row
    cdef void *kind  # as of the fields that it has; NULL: it has none


cdef class Field:
    """A field of a struct as an attribute."""

    cdef void *kind  # names the struct
    cdef Py_ssize_t at
    cdef size_t size

    cdef void *place_in(self, Row owner) except NULL:
        """Return where it lies in a row, which Python may have taken from another class."""
        if self.kind == NULL or owner.kind != self.kind:
            raise TypeError(f"{type(owner).__name__} has no such field")
        return owner.row + self.at

    def __get__(self, Row owner, _):
        if owner is None:
            return self
        field = self.place_in(owner)
        if self.size == sizeof(uint64_t):
            return (<uint64_t *>field)[0]
        if self.size == sizeof(uint32_t):
            return (<uint32_t *>field)[0]
        return (<c_bool *>field)[0]

    def __set__(self, Row owner not None, value):
        field = self.place_in(owner)
        if self.size == sizeof(uint64_t):
            (<uint64_t *>field)[0] = word(value)
        elif self.size == sizeof(uint32_t):
            (<uint32_t *>field)[0] = PyNumber_Index(value)
        else:
            (<c_bool *>field)[0] = value


cdef Field field(void *row, void *place, size_t size):
    """Return the attribute for a field, of which this is the place in one such row."""
    made = <Field>Field.__new__(Field)
    made.kind, made.at, made.size = row, <char *>place - <char *>row, size
    return made


# Rows that nobody uses, to find the places of their fields.
cdef subscription_row a_subscription
cdef channel_row a_channel
cdef link_row a_link
cdef slot_row a_slot


cdef class Subscription(Row):
    """Where the attributes of a Subscription of directory.py lie."""

    cdef subscription_row subscription

    index = field(&a_subscription, &a_subscription.index, 8)
    at = field(&a_subscription, &a_subscription.at, 8)
    slot = field(&a_subscription, &a_subscription.slot, 8)
    declaration = field(&a_subscription, &a_subscription.declaration, 8)
    newest_only = field(&a_subscription, &a_subscription.newest_only, 1)

    def __cinit__(self, *_, **__):
        self.row, self.kind = <char *>&self.subscription, &a_subscription

    @property
    def queued(self):
        return None if self.subscription.queued == NO_REFERENCE else self.subscription.queued

    @queued.setter
    def queued(self, reference):
        self.subscription.queued = NO_REFERENCE if reference is None else <uint32_t>PyNumber_Index(reference)


@cython.no_gc_clear  # Books let go of it first
cdef class Channel(Row):
    """Where the attributes of a Channel of directory.py lie."""

    cdef channel_row channel
    cdef tuple kept

    index = field(&a_channel, &a_channel.index, 8)
    at = field(&a_channel, &a_channel.at, 8)
    paced_sequence = field(&a_channel, &a_channel.paced_sequence, 8)
    paced_reference = field(&a_channel, &a_channel.paced_reference, 4)

    def __cinit__(self, *_, **__):
        self.row, self.kind = <char *>&self.channel, &a_channel

    def __dealloc__(self):
        PyMem_Free(self.channel.subscriptions)

    @property
    def subscriptions(self):
        return self.kept

    @subscriptions.setter
    def subscriptions(self, tuple subscriptions not None):
        cdef uint64_t count = len(subscriptions)
        cdef Subscription subscription
        rows = <subscription_row **>zeros(count, sizeof(subscription_row *))
        try:
            for index in range(count):
                subscription = subscriptions[index]
                if subscription is None:
                    raise TypeError("must be a tuple of subscriptions")
                rows[index] = &subscription.subscription
            rows, self.channel.subscriptions = self.channel.subscriptions, rows
        finally:
            PyMem_Free(rows)
        self.channel.subscription_count = count
        self.kept = subscriptions


@cython.no_gc_clear  # Books let go of it first
cdef class Link(Row):
    """Where the attributes of a Link of members.py lie.

    C uses the objects that it has when it is first needed, and keeps them.
    """

    cdef link_row link
    cdef public RingReader outbound
    cdef public RingWriter inbound
    cdef public NumberRingWriter freed
    cdef public References pushed, pinned
    cdef public object wake, in_flight, windows
    cdef dict by_declaration
    cdef tuple used
    cdef uint64_t slots  # how many the numbers are for
    cdef Wakeup wakeup  # that of `wake`; None: `wake` must be called

    slot = field(&a_link, &a_link.slot, 8)
    source = field(&a_link, &a_link.source, 8)
    credit = field(&a_link, &a_link.credit, 8)
    awaited_freed = field(&a_link, &a_link.awaited_freed, 8)
    wanted_release = field(&a_link, &a_link.wanted_release, 8)
    ready = field(&a_link, &a_link.ready, 1)
    has_ended = field(&a_link, &a_link.has_ended, 1)
    paces = field(&a_link, &a_link.paces, 1)

    def __cinit__(self, *_, **__):
        self.row, self.kind = <char *>&self.link, &a_link
        self.link.owner = <void *>self

    @property
    def channels(self):
        return self.by_declaration

    @channels.setter
    def channels(self, dict channels not None):
        cdef Channel channel
        for number in channels:
            if word(number) >= DECLARATION_COUNT or not isinstance(channels[number], Channel):
                raise ValueError("must be a dict of channels by declaration")
        memset(self.link.channels, 0, DECLARATION_COUNT * sizeof(channel_row *))
        for number, channel in channels.items():
            self.link.channels[word(number)] = &channel.channel
        self.by_declaration = channels

    cdef int use(self) except -1:
        """Let C use what it has; once."""
        if None in (self.outbound, self.inbound, self.freed, self.pushed, self.pinned):
            raise ValueError("must be a whole link")
        in_flight, windows = Numbers(self.in_flight), Numbers(self.windows)
        self.link.outbound = &self.outbound.ring
        self.link.inbound, self.link.freed = &self.inbound.ring, &self.freed.ring
        self.link.pushed, self.link.pinned = &self.pushed.list, &self.pinned.list
        self.link.in_flight, self.link.windows = (<Numbers>in_flight).numbers, (<Numbers>windows).numbers
        self.slots = min((<Numbers>in_flight).count, (<Numbers>windows).count)
        self.wakeup = posted_by(self.wake)
        ends = self.outbound, self.inbound, self.freed
        self.used = ends, self.pushed, self.pinned, in_flight, windows, self.wake
        return 0

    cdef int require_whole(self, uint64_t slots) except -1:
        """Require all that C needs, for a run of this number of slots."""
        if self.used is None:
            self.use()
        if (
            self.link.outbound.place.records == NULL
            or self.link.inbound.place.records == NULL
            or self.link.freed.place.records == NULL
            or slots > self.slots
        ):
            raise ValueError("must be a whole link")
        return 0


@cython.no_gc_clear  # Books let go of it first
cdef class Slot(Row):
    """Where the attributes of a Slot of members.py lie."""

    cdef slot_row slot
    cdef References queue
    cdef Link connected

    index = field(&a_slot, &a_slot.index, 8)
    at = field(&a_slot, &a_slot.at, 8)
    queue_messages = field(&a_slot, &a_slot.queue_messages, 8)
    queue_bytes = field(&a_slot, &a_slot.queue_bytes, 8)
    waiting_bytes = field(&a_slot, &a_slot.waiting_bytes, 8)
    yields = field(&a_slot, &a_slot.yields, 1)

    def __cinit__(self, *_, **__):
        self.row, self.kind = <char *>&self.slot, &a_slot

    @property
    def waiting(self):
        return self.queue

    @waiting.setter
    def waiting(self, References references not None):
        self.slot.waiting = &references.list
        self.queue = references

    @property
    def link(self):
        return self.connected

    @link.setter
    def link(self, Link link):
        if link is None:
            self.slot.link = NULL
        else:
            link.require_whole(self.slot.index + 1)
            if link.link.slot != self.slot.index:
                raise ValueError("must be a link of this slot")
            self.slot.link = &link.link
        self.connected = link


cdef void wake_module(void *_, link_row *row) except *:
    if PyErr_Occurred():
        return
    link = <Link>row.owner
    if link.wakeup is not None:
        wakeup_post(&link.wakeup.wakeup)
    else:
        link.used[-1]()


cdef uint64_t real_time_ns() noexcept:
    """Return the time; not of the clock that tests set, which C and Python look at equally often."""
    cdef timespec now
    clock_gettime(CLOCK_MONOTONIC, &now)
    return <uint64_t>now.tv_sec * 1000000000 + now.tv_nsec


cdef class Books:
    """What the core knows of a run besides its tables, and the hot path over it."""

    cdef books_of_core books
    cdef router_of_books router
    cdef held_words words
    cdef Numbers holders
    cdef FreeRows free_handles, free_references
    cdef list subscriptions  # those that books.subscriptions names
    cdef tuple slots  # None, as after a garbage collection: nothing is served
    cdef tuple links  # those that books.links names
    cdef tuple links_in_round  # None: there is no round
    cdef uint64_t link_room  # of the arrays of links

    def __cinit__(
        self,
        words,
        uint64_t handles_at,
        uint64_t references_at,
        uint64_t subscriptions,
        FreeRows free_handles not None,
        FreeRows free_references not None,
        holders,
        uint64_t message_bytes,
    ):
        hold_words(&self.words, words, True)
        self.holders = Numbers(holders)
        self.free_handles, self.free_references = free_handles, free_references
        books = &self.books
        books.words = self.words.words
        books.holders = self.holders.numbers
        books.free_handles, books.free_references = &free_handles.rows, &free_references.rows
        books.handle_count, books.reference_count = free_handles.rows.capacity, free_references.rows.capacity
        books.subscription_count = subscriptions
        if (
            not self.fits(handles_at, books.handle_count, HANDLE_WORDS)
            or not self.fits(references_at, books.reference_count, REFERENCE_WORDS)
            or self.holders.count < books.handle_count
        ):
            raise ValueError("the tables do not fit into their memory")
        books.handle_rows, books.reference_rows = books.words + handles_at, books.words + references_at
        books.places = <place_in_list *>zeros(books.reference_count, sizeof(place_in_list))
        books.subscriptions = <subscription_row **>zeros(subscriptions, sizeof(void *))
        self.subscriptions = [None] * subscriptions
        self.router.claims = <uint32_t *>zeros(subscriptions, sizeof(uint32_t))
        self.router.books = books
        self.router.message_bytes = message_bytes
        self.router.wake = wake_module

    def __dealloc__(self):
        PyMem_Free(self.books.places)
        PyMem_Free(self.books.slots)
        PyMem_Free(self.books.subscriptions)
        PyMem_Free(self.books.links)
        PyMem_Free(self.router.claims)
        PyMem_Free(self.router.round.links)
        PyMem_Free(self.router.round.releasing)
        PyMem_Free(self.router.round.unfinished)
        release_words(&self.words)

    @property
    def is_wanting(self):
        """Whether some module may have been asked to post when it releases."""
        return self.books.is_wanting

    @is_wanting.setter
    def is_wanting(self, bint is_wanting):
        self.books.is_wanting = is_wanting

    @property
    def left(self):
        """Records of a turn behind the one to be handled; None: the ring is corrupt."""
        return None if self.router.round.left == UINT64_MAX else self.router.round.left

    @property
    def is_unfinished(self):
        """Whether rings have more records than the round handled."""
        return self.router.round.unfinished_count != 0

    cdef bint fits(self, uint64_t at, uint64_t count, uint64_t row_words):
        return at <= <uint64_t>self.words.count and count <= (self.words.count - at) // row_words

    def set_slots(self, tuple slots not None):
        """Set the slots, in order; once."""
        cdef Slot slot
        if self.slots is not None:
            raise TypeError("the slots are set once")
        for index, slot in enumerate(slots):
            if slot is None or slot.slot.index != index or slot.queue is None or not self.fits(slot.slot.at, 1, PUBLISHER_WORDS):
                raise ValueError("must be the slots, in order")
        self.books.slots = <slot_row **>zeros(len(slots), sizeof(slot_row *))
        for slot in slots:
            self.books.slots[slot.slot.index] = &slot.slot
        self.slots = slots
        self.books.slot_count = len(slots)

    def references(self):
        """Return a new, empty list of references."""
        return References(self)

    def enter(self, Subscription subscription not None):
        """Enter a subscription under its row."""
        row = &subscription.subscription
        if (
            row.index >= self.books.subscription_count
            or row.slot >= self.books.slot_count
            or not self.fits(row.at, 1, SUBSCRIPTION_WORDS)
        ):
            raise ValueError("must be a subscription in one of the rows")
        self.books.subscriptions[row.index] = row
        self.subscriptions[row.index] = subscription

    def outdate(self, Slot slot not None):
        """Note that the figures of a slot must be written again."""
        index = slot.slot.index
        if index >= self.books.slot_count or self.books.slots[index] != &slot.slot:
            raise ValueError("must be one of the slots")
        outdate(&self.books, &slot.slot)

    def note_post(self, Link link not None):
        """Have a link be woken, for it has been sent records."""
        index = link.link.slot
        if self.slots is None or index >= self.books.slot_count or self.books.slots[index].link != &link.link:
            raise ValueError("must be the link of one of the slots")
        note_post(&self.books, &link.link)

    def post(self):
        """Wake the links that have been sent records."""
        if self.slots is not None:
            post(&self.router)

    def write_figures(self):
        """Write the figures that have changed."""
        if self.slots is not None:
            try_to_write_figures(&self.books)

    def somebody_waits(self):
        """Whether messages wait for a module."""
        return self.slots is not None and somebody_waits(&self.books)

    def before_sleep(self):
        """Ask modules to post on a release, or not to; return whether the rings must be looked at again."""
        cdef c_bool again = False
        if self.slots is not None:
            before_a_sleep(&self.books, &again)
        return again

    def serve(self, Link link not None, uint64_t records, is_special):
        """Handle the next records of a link as far as they are common; return how many were."""
        cdef uint64_t handled = 0
        if self.slots is None or link.link.slot >= self.books.slot_count:
            raise ValueError("must be a whole link")
        link.require_whole(self.books.slot_count)
        self.router.is_special = bool(is_special)
        try_to_serve(&self.router, &link.link, records, &handled)
        return handled

    def set_links(self, tuple links not None):
        """Set the links that are connected."""
        cdef uint64_t count = len(links)
        cdef Link link
        if self.links_in_round is not None:
            raise TypeError("links are set between rounds")
        for link in links:
            if link is None:
                raise TypeError("must be a tuple of links")
            link.require_whole(self.books.slot_count)
            if link.link.slot >= self.books.slot_count:
                raise ValueError("must be whole links")
        if count > self.link_room:
            grow(&self.books.links, count)
            grow(&self.router.round.links, count)
            grow(&self.router.round.releasing, count)
            grow(&self.router.round.unfinished, count)
            self.link_room = count
        for index in range(count):
            link = links[index]
            link.link.head_seen = link.link.outbound.tail
            self.books.links[index] = &link.link
        self.books.link_count = count
        self.links = links

    cdef object go_on(self, uint64_t records_per_turn):
        """Begin a round or go on with it; a link of which Python must handle a record, or None when it is over."""
        cdef link_row *link = NULL
        if self.links_in_round is None:
            begin_round(&self.router)
            self.links_in_round = self.links
        try:
            go_on_with_round(&self.router, records_per_turn, &link)
        finally:  # a wake may have failed at the end of the round
            if link == NULL:
                self.links_in_round = None
        return None if link == NULL else <Link>link.owner

    def serve_round(self, uint64_t records_per_turn, is_special):
        """Begin or go on with a round; return a link of which Python must handle a record, None when it is over."""
        if self.links is None:
            return None
        self.router.is_special = bool(is_special)
        return self.go_on(records_per_turn)

    cdef int sleep(self, Wakeup wakeup, uint64_t timeout_ns) except -1:
        """Wait for a post without the GIL; 0, or the error's number."""
        wakeups = self.books.words + CORE_WAKEUPS
        try_to_store(wakeups, load(wakeups) + 1)
        cdef int error = wakeup.sleep(timeout_ns)
        try_to_store(self.books.words + CORE_HEARTBEAT_NS, real_time_ns())
        return error

    def work(self, post, uint64_t records_per_turn, uint64_t heartbeat_ns, is_special):
        """Wait for posts and handle what is common, until Python must do something."""
        wakeup = posted_by(post)
        cdef c_bool again = False
        if wakeup is None or wakeup.wakeup.posts == NULL or self.links is None:
            raise TypeError("expected the post of a wake-up in C, and the links to be set")
        self.router.is_special = bool(is_special)
        cdef uint64_t end_ns = real_time_ns() + heartbeat_ns
        while True:
            error = self.sleep(wakeup, heartbeat_ns)
            if error in (ETIMEDOUT, EINTR):
                return None
            if error != 0:
                raise_os_error(error)
            while True:
                link = self.go_on(records_per_turn)
                if link is not None:
                    return link
                if self.router.round.unfinished_count == 0:
                    before_a_sleep(&self.books, &again)
                    if not again:
                        break
                if real_time_ns() >= end_ns:
                    break
            if real_time_ns() >= end_ns:
                return None


cdef int grow(link_row ***array, uint64_t count) except -1:
    """Make room in an array of links."""
    grown = <link_row **>PyMem_Realloc(array[0], count * sizeof(link_row *))
    if grown == NULL:
        raise MemoryError
    array[0] = grown
    return 0
