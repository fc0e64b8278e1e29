# The Python type Endpoint: what robbie_mp/bus/transport/endpoint.py leaves to C.

cdef extern from "layout.h":
    enum: IN_WANT_RELEASE

cdef extern from "endpoint.h":
    struct endpoint:
        ring_writer *outbound
        ring_reader *inbound
        ring_reader *freed
        const shared_word *want_release
        uint64_t source, reserve
    struct placed_message:
        uint64_t segment, offset, size, block
    struct delivery_of_core "delivery":
        uint64_t declaration, channel, reference, sequence, source, offset, size, stamp_ns
    enum: FOUND_NOTHING, FOUND_DELIVERY
    bint endpoint_may_publish(const endpoint *endpoint)
    int endpoint_look(endpoint *endpoint, delivery_of_core *delivery)

cdef extern from "endpoint_bindings.h":
    bint endpoint_is_mine(Endpoint endpoint)
    int endpoint_wake_core(Endpoint endpoint) except -1
    bint endpoint_give_back(Endpoint endpoint, uint64_t kind, uint64_t reference, uint64_t sequence) except -1
    object new_delivery(type delivery_type, const delivery_of_core *delivery)

cdef extern from *:
    """
    GUARDED(try_to_publish, (struct endpoint *endpoint, uint64_t declaration, const struct placed_message *placed,
                             uint64_t stamp_ns),
            endpoint_publish(endpoint, declaration, placed, stamp_ns))
    """
    int try_to_publish(
        endpoint *endpoint, uint64_t declaration, const placed_message *placed, uint64_t stamp_ns
    ) except -1


@cython.no_gc_clear  # code that reads it during a collection finds all of it
cdef public class Endpoint [object endpoint_object, type endpoint_type]:
    """The common form of what robbie_mp.bus.transport.endpoint.Endpoint does."""

    cdef endpoint endpoint
    cdef WritingEnd outbound
    cdef ReadingEnd inbound, freed
    cdef held_words in_words
    cdef object backlog  # records that did not fit into the ring: while there are any, Python does all
    cdef Lock lock
    cdef object wake_core
    cdef wakeup *core  # to which wake_core posts; NULL: it must be called
    cdef type delivery_type
    cdef c_bool is_disowned  # this is a forked process

    def __cinit__(
        self,
        RingWriter outbound not None,
        RingReader inbound not None,
        NumberRingReader freed not None,
        in_words,
        uint64_t source,
        uint64_t reserve,
        backlog,
        Lock lock not None,
        wake_core,
        type delivery not None,
    ):
        if not issubclass(delivery, tuple):
            raise TypeError("a delivery must be a named tuple")
        self.outbound, self.inbound, self.freed = outbound, inbound, freed
        self.backlog, self.lock, self.wake_core = backlog, lock, wake_core
        self.core = wakeup_of(wake_core)
        self.delivery_type = delivery
        hold_words(&self.in_words, in_words, False)
        if self.in_words.count <= IN_WANT_RELEASE:
            raise ValueError("these are not the words of an inbound segment")
        end = &self.endpoint
        end.outbound, end.inbound, end.freed = &outbound.ring, &inbound.ring, &freed.ring
        end.want_release = self.in_words.words + IN_WANT_RELEASE
        end.source, end.reserve = source, reserve

    def __dealloc__(self):
        release_words(&self.in_words)

    def publish(
        self,
        uint64_t declaration,
        uint64_t segment,
        uint64_t offset,
        uint64_t size,
        uint64_t stamp_ns,
        uint64_t block,
        /,
    ):
        """Publish a filled block; False if this is not mine."""
        cdef placed_message placed = [segment, offset, size, block]
        if not endpoint_is_mine(self) or not endpoint_may_publish(&self.endpoint):
            return False
        try_to_publish(&self.endpoint, declaration, &placed, stamp_ns)
        endpoint_wake_core(self)
        return True

    def give_back(self, uint64_t kind, uint64_t reference, uint64_t sequence, /):
        """Push RELEASE or DONE; False if this is not mine."""
        return endpoint_give_back(self, kind, reference, sequence)

    def take(self):
        """Take the next delivery; None if there is no record, NotImplemented if this is not mine."""
        cdef delivery_of_core delivery
        if not endpoint_is_mine(self):
            return NotImplemented
        found = endpoint_look(&self.endpoint, &delivery)
        if found == FOUND_NOTHING:
            return None
        if found != FOUND_DELIVERY:
            return NotImplemented
        made = new_delivery(self.delivery_type, &delivery)
        try_to_take(self.endpoint.inbound)
        return made

    def close(self):
        """Let go of the memory."""
        release_words(&self.in_words)
        self.core = NULL

    def disown(self):
        """Do nothing any more, in a forked process."""
        self.is_disowned = True
        self.close()
