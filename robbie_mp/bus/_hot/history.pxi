# The Python type History, with the interface of HistoryWriter in robbie_mp/bus/transport/history.py.

cdef extern from "Python.h":
    uint64_t PyLong_AsUnsignedLongLongMask(object number) except? 0xFFFFFFFFFFFFFFFF

cdef extern from "layout.h":
    enum: HISTORY_CAPACITY, HISTORY_RING

cdef extern from "history.h":
    enum: MIN_RING_WORDS
    struct history_event:
        uint64_t kind, time_ns
        uint64_t *values

cdef extern from *:
    """
    GUARDED(try_to_append, (struct history_object *history, const struct history_event *event, const void *data, uint64_t size),
            history_append(history, event, data, size))
    GUARDED(try_to_prepare, (struct history_object *history), history_prepare(history))
    """
    int try_to_append(History history, const history_event *event, const void *data, uint64_t size) except -1
    int try_to_prepare(History history) except -1


cdef public class History [object history_object, type history_type]:
    """What a module has handled."""

    cdef held_words words
    cdef uint64_t capacity, most_capacity  # bytes of the ring: now, and when it has grown
    cdef uint64_t key_at  # where the newest large message is
    cdef c_bool has_key, is_disowned

    def __cinit__(self, words, uint64_t ready_bytes=0):
        hold_words(&self.words, words, True)
        if self.words.count < HISTORY_RING + MIN_RING_WORDS:
            raise ValueError("these words are no history")
        cdef uint64_t whole_bytes = self.words.count * 8
        if ready_bytes == 0:
            ready_bytes = whole_bytes
        if not (HISTORY_RING + MIN_RING_WORDS) * 8 <= ready_bytes <= whole_bytes or ready_bytes % 8:
            raise ValueError("so much of a history cannot be ready")
        self.most_capacity = whole_bytes - HISTORY_RING * 8
        self.capacity = ready_bytes - HISTORY_RING * 8
        try_to_store(self.words.words + HISTORY_CAPACITY, self.capacity)

    def __dealloc__(self):
        release_words(&self.words)

    def append(self, kind, time_ns=0, a=0, b=0, c=0, d=0, data=None, /):
        """Append an event: its kind, its time, up to four values, its data."""
        cdef history_event event
        cdef Py_buffer view
        event.kind, event.time_ns = PyLong_AsUnsignedLongLongMask(kind), PyLong_AsUnsignedLongLongMask(time_ns)
        event.values[0], event.values[1] = PyLong_AsUnsignedLongLongMask(a), PyLong_AsUnsignedLongLongMask(b)
        event.values[2], event.values[3] = PyLong_AsUnsignedLongLongMask(c), PyLong_AsUnsignedLongLongMask(d)
        if data is None:
            try_to_append(self, &event, NULL, 0)
            return
        PyObject_GetBuffer(data, &view, PyBUF_SIMPLE)
        try:
            try_to_append(self, &event, view.buf, view.len)
        finally:
            PyBuffer_Release(&view)

    def prepare(self):
        """Take memory for what comes next."""
        try_to_prepare(self)

    def close(self):
        """Let go of the memory."""
        release_words(&self.words)

    def disown(self):
        """Record nothing in a forked process."""
        self.is_disowned = True
