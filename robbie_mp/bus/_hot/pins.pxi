# What a module has mapped of other modules' memory, and what is still in use of it: the Python types MappedSegment,
# MessageBytes, PinnedBuffer, Unreferenced and Pins.
from cpython.mem cimport PyMem_Malloc

cdef extern from "layout.h":
    const uint64_t SOURCE_OF_INCARNATION
    enum: MAX_PINNED, OUT_PINNED, OUT_PINNED_BYTES, PINNED_SHARE

cdef extern from *:
    """
    GUARDED(show_pinned, (shared_word *words, uint64_t messages, uint64_t bytes),
            store(words + OUT_PINNED, messages);
            store(words + OUT_PINNED_BYTES, bytes))

    /* Cython calls __getbuffer__ with a reference to None in the view, which PyBuffer_FillInfo would overwrite. */
    static int fill_view(Py_buffer *view, PyObject *owner, void *first, Py_ssize_t size, int readonly, int flags)
    {
        Py_CLEAR(view->obj);
        return PyBuffer_FillInfo(view, owner, first, size, readonly, flags);
    }
    """
    int fill_view(
        Py_buffer *view, object owner, void *first, Py_ssize_t size, bint readonly, int flags
    ) except -1
    int show_pinned(shared_word *words, uint64_t messages, uint64_t bytes) except -1


cdef struct reference_node:  # a number in a list that a finalizer can lengthen: it takes no memory then
    reference_node *next
    uint64_t reference


cdef public class MappedSegment [object mapped_segment_object, type mapped_segment_type]:
    """A data segment of another module, mapped as long as this object exists."""

    cdef held_words words

    def __cinit__(self, buffer):
        hold_words(&self.words, buffer, False)
        if self.words.count < DATA_BLOCKS:
            raise ValueError("this is not a data segment")

    def __dealloc__(self):
        release_words(&self.words)


cdef public class Unreferenced [object unreferenced_object, type unreferenced_type]:
    """References to messages that nothing refers to any more, first in, first out; finalizers add to them."""

    cdef reference_node *first
    cdef reference_node *last  # undefined if there is none
    cdef Py_ssize_t count

    def __dealloc__(self):
        while self.first != NULL:
            self.take()

    cdef void add(self, reference_node *node) noexcept:
        if self.first == NULL:
            self.first = node
        else:
            self.last.next = node
        self.last = node
        self.count += 1

    cdef uint64_t take(self) noexcept:
        """Take the first of the references, of which there must be one."""
        node = self.first
        reference = node.reference
        self.first = node.next
        self.count -= 1
        PyMem_Free(node)
        return reference

    def __len__(self):
        return self.count

    def append(self, uint64_t reference, /):
        """Add a reference."""
        self.add(new_node(reference))

    def popleft(self):
        """Take the first reference."""
        if self.first == NULL:
            raise IndexError("there is no reference")
        return self.take()

    def remove(self, uint64_t reference, /):
        """Take out a reference; ValueError: there is none such."""
        cdef reference_node *before = NULL
        cdef reference_node *node = self.first
        while node != NULL and node.reference != reference:
            before, node = node, node.next
        if node == NULL:
            raise ValueError("there is no such reference")
        if before == NULL:
            self.first = node.next
        else:
            before.next = node.next
        if self.last == node:
            self.last = before
        self.count -= 1
        PyMem_Free(node)


cdef reference_node *new_node(uint64_t reference) except NULL:
    node = <reference_node *>PyMem_Malloc(sizeof(reference_node))
    if node == NULL:
        raise MemoryError
    node.next, node.reference = NULL, reference
    return node


cdef public uint64_t pop_reference(Unreferenced references) noexcept:
    return references.take()


@cython.final
@cython.no_gc  # it refers to nothing that could refer to it
cdef public class MessageBytes [object message_bytes_object, type message_bytes_type]:
    """The bytes of a message in its publisher's memory.

    Every view of them, however derived, refers to this object; so it is deallocated when the last one is gone,
    in whatever thread that happens.
    """

    cdef MappedSegment segment
    cdef Unreferenced unreferenced
    cdef reference_node *node  # to be added to `unreferenced` at the end; NULL: nobody waits for that
    cdef uint8_t *first
    cdef uint64_t size

    def __dealloc__(self):
        if self.node != NULL:
            self.unreferenced.add(self.node)

    def __getbuffer__(self, Py_buffer *view, int flags):
        fill_view(view, self, self.first, self.size, True, flags)


cdef public MessageBytes new_message_bytes(MappedSegment segment, uint64_t start, uint64_t size):
    """Return the bytes of a message, which must lie in the segment."""
    made = <MessageBytes>MessageBytes.__new__(MessageBytes)
    made.segment = segment
    made.first = <uint8_t *>segment.words.words + start
    made.size = size
    return made


cdef public int keep_message_bytes(MessageBytes one, Unreferenced unreferenced, uint64_t reference) except -1:
    """Add this reference to `unreferenced` when the last view of the bytes is gone."""
    one.node = new_node(reference)
    one.unreferenced = unreferenced
    return 0


@cython.final
@cython.no_gc
cdef class PinnedBuffer:
    """Keeps the object that a message was decoded from, for its arrays.

    A view of a view refers to what the first one shows, not to the first view itself; of this object it refers
    to this object, and this object keeps what it was given.
    """

    cdef Py_buffer buffer

    def __dealloc__(self):
        PyBuffer_Release(&self.buffer)  # this does nothing if there is none

    def __getbuffer__(self, Py_buffer *view, int flags):
        fill_view(view, self, self.buffer.buf, self.buffer.len, self.buffer.readonly, flags)


cdef public object pinned_buffer(object buffer, int flags):
    """Return an object with the buffer of `buffer`: a reference to it keeps `buffer`, not only what that refers to."""
    made = <PinnedBuffer>PinnedBuffer.__new__(PinnedBuffer)
    PyObject_GetBuffer(buffer, &made.buffer, flags)
    return made


cdef class PinnedPublisher:
    """What is pinned of one incarnation of a publisher."""

    cdef uint64_t messages, bytes


@cython.no_gc_clear
cdef public class Pins [object pins_object, type pins_type]:
    """The messages that a module keeps from being released; see robbie_mp.module.pins.Pins."""

    cdef dict by_reference  # delivery, and what is kept alive with it, by the reference
    cdef dict publishers  # those of which something is pinned, by their incarnation
    cdef held_words words
    cdef uint64_t bytes

    def __cinit__(self, words):
        self.by_reference, self.publishers = {}, {}
        hold_words(&self.words, words, True)
        if self.words.count < OUT_RING:
            raise ValueError("these are not the words of an outbound segment")

    def __dealloc__(self):
        release_words(&self.words)

    def __len__(self):
        return len(self.by_reference)

    def add(self, delivery, kept, /):
        """Pin a delivered message, with an object that is to live as long."""
        _, _, reference, _, source, _, size, _ = delivery  # as `remove` reads it, whatever its attributes say
        self.pin(delivery, kept, reference, source, size)

    cdef int pin(self, delivery, kept, uint64_t reference, uint64_t source, uint64_t size) except -1:
        key = source & SOURCE_OF_INCARNATION
        publisher = <PinnedPublisher>self.publishers.get(key)
        if publisher is None:
            publisher = PinnedPublisher()
        self.by_reference[reference] = delivery, kept
        self.publishers[key] = publisher
        publisher.messages += 1
        publisher.bytes += size
        self.bytes += size
        return self.show()

    def remove(self, uint64_t reference, /):
        """Return the delivery of a message that is no longer pinned."""
        delivery, _ = self.by_reference[reference]
        _, _, _, _, source, _, size, _ = delivery
        key = source & SOURCE_OF_INCARNATION
        publisher = <PinnedPublisher?>self.publishers[key]
        del self.by_reference[reference]
        publisher.messages -= 1
        publisher.bytes -= <uint64_t>size
        self.bytes -= <uint64_t>size
        if publisher.messages == 0:
            del self.publishers[key]
        self.show()
        return delivery

    cdef int show(self) except -1:
        if self.words.words == NULL:
            raise ValueError("these pins were closed")
        return show_pinned(self.words.words, len(self.by_reference), self.bytes)

    cdef bint has_room(self, uint64_t source, uint64_t size, uint64_t free_bytes) except -1:
        """Whether the limits leave room for a message of a publisher with this number of free bytes."""
        if not self.publishers:
            return True
        publisher = <PinnedPublisher>self.publishers.get(source & SOURCE_OF_INCARNATION)
        if publisher is None:
            return True
        return publisher.messages < MAX_PINNED and PINNED_SHARE * (publisher.bytes + size) <= free_bytes

    def have_room_for(self, delivery, uint64_t free_bytes, /):
        """Whether the limits leave room for a message of a publisher with this number of free bytes."""
        return self.has_room(delivery.source, delivery.size, free_bytes)

    def close(self):
        """Let go of the memory."""
        release_words(&self.words)


cdef public int pins_have_room(Pins pins, const delivery_of_core *delivery, uint64_t free_bytes) except -1:
    return pins.has_room(delivery.source, delivery.size, free_bytes)


cdef public int add_pin(Pins pins, const delivery_of_core *delivery, type delivery_type) except -1:
    """Pin a message, and count it."""
    made = new_delivery(delivery_type, delivery)
    return pins.pin(made, None, delivery.reference, delivery.source, delivery.size)


cdef public object remove_pin(Pins pins, uint64_t reference):
    return pins.remove(reference)
