# The Python types MappedSegment, Unreferenced and Pins; MessageBytes is in C.

cdef extern from *:
    """
    #include "pins.h"
    """
    struct reference_node:
        reference_node *next
        uint64_t reference
    struct pinned_publisher:
        pass
    reference_node *new_node(uint64_t reference) except NULL
    void append_node(Unreferenced references, reference_node *node)
    uint64_t pop_reference(Unreferenced references)
    bint pins_have_room(Pins pins, const delivery_of_core *delivery, uint64_t free_bytes)
    int pin(
        Pins pins, object delivery, object kept, uint64_t reference, uint64_t source, uint64_t size
    ) except -1
    object remove_pin(Pins pins, uint64_t reference)


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
            pop_reference(self)

    def __len__(self):
        return self.count

    def append(self, uint64_t reference, /):
        """Add a reference."""
        append_node(self, new_node(reference))

    def popleft(self):
        """Take the first reference."""
        if self.first == NULL:
            raise IndexError("there is no reference")
        return pop_reference(self)

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


@cython.no_gc_clear
cdef public class Pins [object pins_object, type pins_type]:
    """The messages that a module keeps from being released; see robbie_mp.module.pins.Pins."""

    cdef dict by_reference  # delivery, and what is kept alive with it, by the reference
    cdef held_words words
    cdef pinned_publisher *publishers  # those of which something is pinned
    cdef size_t publisher_count, publisher_room
    cdef uint64_t bytes

    def __cinit__(self, words):
        self.by_reference = {}
        hold_words(&self.words, words, True)
        if self.words.count < OUT_RING:
            raise ValueError("these are not the words of an outbound segment")

    def __dealloc__(self):
        release_words(&self.words)
        PyMem_Free(self.publishers)

    def __len__(self):
        return len(self.by_reference)

    def add(self, delivery, kept, /):
        """Pin a delivered message, with an object that is to live as long."""
        _, _, reference, _, source, _, size, _ = delivery  # as `remove` reads it, whatever its attributes say
        pin(self, delivery, kept, reference, source, size)

    def remove(self, uint64_t reference, /):
        """Return the delivery of a message that is no longer pinned."""
        return remove_pin(self, reference)

    def have_room_for(self, delivery, uint64_t free_bytes, /):
        """Whether the limits leave room for a message of a publisher with this number of free bytes."""
        cdef delivery_of_core wanted
        wanted.source, wanted.size = delivery.source, delivery.size
        return pins_have_room(self, &wanted, free_bytes)

    def close(self):
        """Let go of the memory."""
        release_words(&self.words)
