# The Python type Publisher: what robbie_mp/module/outbox.py leaves to C.

cdef extern from "layout.h":
    enum: OUT_RING

cdef extern from *:
    """
    #include "publisher.h"
    """
    object publisher_publish(Publisher publisher, object message, object topic)
    object publisher_publish_encoded(Publisher publisher, uint64_t declaration, const void *data, uint64_t size)
    object publisher_hand_over(Publisher publisher, Block block, uint64_t declaration, uint64_t size)
    object publisher_outstanding(Publisher publisher)


@cython.no_gc_clear
cdef public class Publisher [object publisher_object, type publisher_type]:
    """The common form of what robbie_mp.module.outbox.Outbox.publish does."""

    cdef Endpoint endpoint
    cdef KeptBlocks blocks
    cdef held_words words
    cdef dict declarations  # numbers of the channels, by message class and topic
    cdef dict held  # blocks of loans whose arrays are referred to after its end; Python frees them
    cdef History history  # None: nothing is recorded
    cdef uint64_t published_when_asked  # messages published when `outstanding` was last called

    def __cinit__(
        self,
        Endpoint endpoint not None,
        KeptBlocks blocks not None,
        words,
        dict declarations not None,
        dict held not None,
    ):
        self.endpoint, self.blocks, self.declarations, self.held = endpoint, blocks, declarations, held
        self.published_when_asked = UINT64_MAX
        hold_words(&self.words, words, True)
        if self.words.count < OUT_RING:
            raise ValueError("these are not the words of an outbound segment")

    def __dealloc__(self):
        release_words(&self.words)

    def record_into(self, History history not None, /):
        """Record from now on what is published."""
        self.history = history

    def publish(self, message, topic, /):
        """Publish a message: True; its size, if Python must prepare the next block; None if this is not mine."""
        return publisher_publish(self, message, topic)

    def publish_encoded(self, uint64_t declaration, data, /):
        """Publish an encoded message, as `publish`: its channel's number, its bytes."""
        cdef Py_buffer view
        PyObject_GetBuffer(data, &view, PyBUF_SIMPLE)
        try:
            return publisher_publish_encoded(self, declaration, view.buf, view.len)
        finally:
            PyBuffer_Release(&view)

    def hand_over(self, uint64_t declaration, Block block not None, uint64_t size, /):
        """Publish a block in use that holds a message, as `publish`: its channel's number, the block, its size."""
        return publisher_hand_over(self, block, declaration, size)

    def outstanding(self):
        """The number of messages that subscribers wait for or hold; None if this is not mine."""
        return publisher_outstanding(self)

    def close(self):
        """Let go of the memory."""
        release_words(&self.words)
        self.declarations.clear()  # so no message is of the common form any more
