# The four ends of rings as Python types, with the interface of robbie_mp/bus/transport/ring.py.

cdef extern from "ring.h":
    enum: RECORD_WORDS
    struct ring_place:
        shared_word *head
        shared_word *records
        shared_word *tail
        uint64_t capacity
    struct ring_writer:
        ring_place place
        uint64_t head
    struct ring_reader:
        ring_place place
        uint64_t tail, looked_up_to
    ring_writer ring_writer_at(ring_place place)
    uint64_t ring_room(const ring_writer *ring)
    ring_reader ring_reader_at(ring_place place)
    uint64_t ring_waiting(const ring_reader *ring)
    bint ring_peek(const ring_reader *ring, uint64_t *record)
    uint64_t ring_glance(const ring_reader *ring)
    uint64_t number_ring_at(const ring_reader *ring, uint64_t index)

cdef extern from *:
    """
    GUARDED(try_to_push, (struct ring_writer *ring, const uint64_t record[7]), ring_push(ring, record))
    GUARDED(try_to_push_number, (struct ring_writer *ring, uint64_t number), number_ring_push(ring, number))
    GUARDED(try_to_take, (struct ring_reader *ring), ring_take(ring))
    GUARDED(try_to_take_numbers, (struct ring_reader *ring, uint64_t count), number_ring_take(ring, count))
    """
    int try_to_push(ring_writer *ring, const uint64_t *record) except -1
    int try_to_push_number(ring_writer *ring, uint64_t number) except -1
    int try_to_take(ring_reader *ring) except -1
    int try_to_take_numbers(ring_reader *ring, uint64_t count) except -1


cdef ring_place hold_ring(
    at, held_words *words, held_words *tail_words, uint64_t record_words, bint is_writer
) except *:
    """Hold the memory of a RingPlace of ring.py; records and head are written here, or else the tail."""
    cdef uint64_t head_at = at.head_at, records_at = at.records_at, tail_at = at.tail_at, capacity = at.capacity
    hold_words(words, at.words, is_writer)
    hold_words(tail_words, at.tail_words, not is_writer)
    cdef uint64_t count = words.count
    if (
        head_at >= count
        or records_at > count
        or capacity == 0
        or capacity & (capacity - 1)
        or capacity > (count - records_at) // record_words
        or tail_at >= <uint64_t>tail_words.count
    ):
        raise ValueError("the ring does not fit into its memory")
    cdef ring_place place
    place.head, place.records = words.words + head_at, words.words + records_at
    place.tail, place.capacity = tail_words.words + tail_at, capacity
    return place


cdef int raise_closed(bint is_disowned) except -1:
    if is_disowned:
        raise_forked_process()
    raise ValueError("this end of a ring was closed")


cdef public class WritingEnd [object ring_writer_object, type writing_end_type]:
    """What the writing ends have in common."""

    cdef held_words words, tail_words
    cdef ring_writer ring
    cdef c_bool is_disowned

    def __dealloc__(self):
        release_words(&self.words)
        release_words(&self.tail_words)

    cdef ring_writer *open(self) except NULL:
        if self.words.words == NULL:
            raise_closed(self.is_disowned)
        return &self.ring

    @property
    def head(self):
        """Number of records that were ever pushed."""
        return self.ring.head

    @head.setter
    def head(self, head):
        self.ring.head = word(head)

    def close(self):
        """Let go of the memory."""
        memset(&self.ring.place, 0, sizeof(ring_place))
        release_words(&self.words)
        release_words(&self.tail_words)

    def disown(self):
        """Let go of the memory, in a forked process."""
        self.is_disowned = True
        self.close()


cdef public class RingWriter(WritingEnd) [object record_writer_object, type ring_writer_type]:
    """The writing end; see robbie_mp.bus.transport.ring.RingWriter."""

    def __cinit__(self, place):
        self.ring = ring_writer_at(hold_ring(place, &self.words, &self.tail_words, RECORD_WORDS, True))

    def room(self):
        """Records that can be pushed now."""
        return ring_room(self.open())

    def push(self, a, b, c, d, e, f, g, /):
        """Append one record of seven words."""
        ring = self.open()
        try_to_push(ring, [word(a), word(b), word(c), word(d), word(e), word(f), word(g)])


cdef public class NumberRingWriter(WritingEnd) [object number_writer_object, type number_ring_writer_type]:
    """The writing end of a ring of numbers; see robbie_mp.bus.transport.ring.NumberRingWriter."""

    def __cinit__(self, place):
        self.ring = ring_writer_at(hold_ring(place, &self.words, &self.tail_words, 1, True))

    def push(self, number, /):
        """Append a number."""
        try_to_push_number(self.open(), word(number))


cdef public class ReadingEnd [object ring_reader_object, type reading_end_type]:
    """What the reading ends have in common."""

    cdef held_words words, tail_words
    cdef ring_reader ring
    cdef c_bool is_disowned

    def __dealloc__(self):
        release_words(&self.words)
        release_words(&self.tail_words)

    cdef ring_reader *open(self) except NULL:
        if self.words.words == NULL:
            raise_closed(self.is_disowned)
        return &self.ring

    cdef uint64_t count(self) except? 0xFFFFFFFFFFFFFFFF:
        """Return how many records wait, unless more do than the ring can hold."""
        ring = self.open()
        cdef uint64_t waiting = ring_waiting(ring)
        if waiting <= ring.place.capacity:
            return waiting
        from robbie_mp.bus.transport.ring import RingCorrupt

        # A head before the tail is a negative number of records.
        claimed = <object>waiting - 2**64 if ring.tail + waiting < ring.tail else <object>waiting
        raise RingCorrupt(f"a ring of {ring.place.capacity} records claims that {claimed} wait")

    @property
    def tail(self):
        """Number of records that were ever taken."""
        return self.ring.tail

    def close(self):
        """Let go of the memory."""
        memset(&self.ring.place, 0, sizeof(ring_place))
        release_words(&self.words)
        release_words(&self.tail_words)

    def disown(self):
        """Let go of the memory, in a forked process."""
        self.is_disowned = True
        self.close()


cdef public class RingReader(ReadingEnd) [object record_reader_object, type ring_reader_type]:
    """The reading end; see robbie_mp.bus.transport.ring.RingReader."""

    def __cinit__(self, place):
        self.ring = ring_reader_at(hold_ring(place, &self.words, &self.tail_words, RECORD_WORDS, False))

    def waiting(self):
        """Records that can be read now."""
        return self.count()

    def peek(self):
        """Read the record at the tail."""
        cdef uint64_t[8] record
        if not ring_peek(self.open(), record):
            from robbie_mp.bus.transport.ring import RingCorrupt

            raise RingCorrupt(f"record {self.ring.tail} of a ring is numbered {record[7]}")
        return tuple([record[word] for word in range(RECORD_WORDS)])

    def glance(self):
        """Return the first word at the tail, unchecked."""
        return ring_glance(self.open())

    def take(self):
        """Advance the tail."""
        try_to_take(self.open())

    def next(self):
        """Read the record at the tail and advance it; None if there is none."""
        ring = self.open()
        if ring.tail == ring.looked_up_to:
            waiting = self.count()
            if waiting == 0:
                return None
            ring.looked_up_to = ring.tail + waiting
        record = self.peek()
        try_to_take(ring)
        return record


cdef public class NumberRingReader(ReadingEnd) [object number_reader_object, type number_ring_reader_type]:
    """The reading end of a ring of numbers; see robbie_mp.bus.transport.ring.NumberRingReader."""

    def __cinit__(self, place):
        self.ring = ring_reader_at(hold_ring(place, &self.words, &self.tail_words, 1, False))

    def take_all(self):
        """Take all numbers in the ring."""
        cdef uint64_t waiting = self.count()
        numbers = [number_ring_at(&self.ring, index) for index in range(waiting)]
        if waiting != 0:
            try_to_take_numbers(&self.ring, waiting)
        return numbers
