# The Python type Subscriber: what robbie_mp/module/inbox.py leaves to C.

cdef extern from "subscriber.h":
    enum: HANDLED_ONE, HANDLED_NONE, HANDLED_NOT_MINE, HANDLED_WITH_ERROR
    int subscriber_handle_next(Subscriber subscriber, object inbox) except HANDLED_WITH_ERROR
    int subscriber_check(Subscriber subscriber) except -1


@cython.no_gc_clear
cdef public class Subscriber [object subscriber_object, type subscriber_type]:
    """The common form of taking and handling a message."""

    cdef Endpoint endpoint
    cdef held_words words
    cdef dict segments  # MappedSegment by the source that names it
    cdef dict subscriptions  # Subscription by its number
    cdef Unreferenced unreferenced
    cdef Pins pins
    cdef object robbie_error
    cdef History history  # None: nothing is recorded
    cdef delivery_of_core handled
    cdef c_bool is_handling

    def __cinit__(
        self,
        Endpoint endpoint not None,
        words,
        dict segments not None,
        dict subscriptions not None,
        Unreferenced unreferenced not None,
        Pins pins not None,
        robbie_error,
    ):
        self.endpoint, self.segments, self.subscriptions = endpoint, segments, subscriptions
        self.unreferenced, self.pins, self.robbie_error = unreferenced, pins, robbie_error
        hold_words(&self.words, words, True)
        if self.words.count < OUT_RING:
            raise ValueError("these are not the words of an outbound segment")

    def __dealloc__(self):
        release_words(&self.words)

    def handle_next(self, inbox, /):
        """Take and handle the next message for an Inbox; False if there is none, None if this is not mine."""
        handled = subscriber_handle_next(self, inbox)
        return None if handled == HANDLED_NOT_MINE else handled == HANDLED_ONE

    def record_into(self, History history not None, /):
        """Record from now on what is handled."""
        self.history = history

    @property
    def current(self):
        """The delivery of the message that is being handled, or None."""
        return new_delivery(self.endpoint.delivery_type, &self.handled) if self.is_handling else None

    @property
    def source(self):
        """The source of the message that is being handled, or None."""
        return self.handled.source if self.is_handling else None

    def close(self):
        """Let go of the memory."""
        release_words(&self.words)
