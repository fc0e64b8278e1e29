# The Python types Loop and TickTimes: what robbie_mp/module/loop.py and ticks.py leave to C.
from libc.math cimport nearbyint

cdef extern from "clock.h":
    uint64_t monotonic_ns()

cdef extern from "layout.h":
    enum: ACTIVITY_IDLE, EVENT_CALLS, EVENT_TICK, OUT_ACTIVITY, OUT_TICKS_MISSED

cdef extern from *:
    """
    #include "figures.h"
    GUARDED(tell_of_tick, (struct subscriber_object *subscriber, shared_word *words, uint64_t event, uint64_t now_ns),
            store(words + OUT_ACTIVITY_SINCE_NS, now_ns);
            store(words + OUT_ACTIVITY, ACTIVITY_TICK);
            subscriber_record(subscriber, event, now_ns))
    GUARDED(count_tick, (shared_word *words, uint64_t late_ns, uint64_t took_ns, unsigned long long *ticks),
            figures_record(words + OUT_TICK_FIGURES, late_ns, took_ns);
            store(words + OUT_TICKS, ++*ticks))
    GUARDED(prepare_history, (struct subscriber_object *subscriber), subscriber_prepare_history(subscriber))
    """
    int tell_of_tick(Subscriber subscriber, shared_word *words, uint64_t event, uint64_t now_ns) except -1
    int count_tick(
        shared_word *words, uint64_t late_ns, uint64_t took_ns, unsigned long long *ticks
    ) except -1
    int prepare_history(Subscriber subscriber) except -1

# Periods of which C computes the next tick; Python has others, and those that are no period.
cdef double MIN_PERIOD_NS = 1.0, MAX_PERIOD_NS = 1e17
cdef enum: NO_PERIOD = 0, ODD_PERIOD = -1
# As in calls/due.py.
cdef int64_t NEVER_NS = INT64_MAX


cdef class TickTimes:
    """When the next tick of a module is due in ns, how many there were, and how many were skipped."""

    cdef public long long due_ns
    cdef public unsigned long long ticks, missed


cdef int64_t now_ns() noexcept:
    return monotonic_ns()


cdef int64_t sooner(int64_t wait_ns, int64_t due_ns) noexcept:
    return max(0, min(due_ns - now_ns(), wait_ns))


@cython.no_gc_clear
cdef class Loop:
    """The common form of a turn of a module's loop."""

    cdef object runner, inbox, outbox, module, calls, calls_due, ticks
    cdef Subscriber subscriber
    cdef TickTimes times
    cdef Wakeup wakeup  # to which `wake` posts
    cdef int64_t max_wait_ns

    def __cinit__(
        self,
        runner,
        Subscriber subscriber not None,
        inbox,
        outbox,
        module,
        calls,
        ticks,
        TickTimes times not None,
        wake,
        int64_t max_wait_ns,
    ):
        self.wakeup = posted_by(wake)
        if self.wakeup is None:
            raise TypeError("expected the post of a wake-up in C")
        self.runner, self.subscriber, self.inbox, self.outbox = runner, subscriber, inbox, outbox
        self.module, self.calls, self.calls_due, self.ticks = module, calls, calls.due, ticks
        self.times, self.max_wait_ns = times, max_wait_ns

    def turn(self):
        """Handle at most one message and run at most one tick, or wait for either; False if this is not mine."""
        period_ns = self.period_ns()
        if period_ns == ODD_PERIOD or self.wakeup.wakeup.posts == NULL:
            return False
        handled = subscriber_handle_next(self.subscriber, self.inbox)
        if handled == HANDLED_NOT_MINE:
            return False
        if handled == HANDLED_ONE:
            period_ns = self.period_ns()  # the handler may have changed it
        self.take_rest_of_turn(period_ns, handled == HANDLED_ONE)
        return True

    cdef int64_t period_ns(self) except? -2:
        """Read the module's period; with ODD_PERIOD, Python must do what depends on it."""
        period_s = self.module.period_s
        cdef double ns = 0.0
        if period_s is None:
            return NO_PERIOD
        if isinstance(period_s, float):
            ns = <double>period_s * 1e9
        elif isinstance(period_s, int):
            try:
                ns = <double>period_s * 1e9
            except OverflowError:
                return ODD_PERIOD
        if not MIN_PERIOD_NS <= ns <= MAX_PERIOD_NS:
            return ODD_PERIOD
        return <int64_t>nearbyint(ns)  # as Python's round: halves to even

    cdef int take_rest_of_turn(self, int64_t period_ns, bint was_one) except -1:
        """Do what a turn does after it has looked for a message."""
        due_ns = self.calls_due_ns()
        if due_ns != NEVER_NS and now_ns() >= due_ns:
            if was_one and self.runner.ends:
                return 0
            self.begin_tick(EVENT_CALLS)
            self.calls.run()
            self.end_tick()
            if self.runner.ends:
                return 0
            period_ns = self.period_ns()
        if period_ns == ODD_PERIOD:
            return 0  # the next turn is not mine
        if period_ns != NO_PERIOD and now_ns() >= self.times.due_ns:
            if not (was_one and self.runner.ends):
                self.tick()
        elif not was_one:
            self.wait(period_ns)
        return 0

    cdef int64_t calls_due_ns(self) except? -1:
        """Read when something is to be done for the module's calls."""
        return self.calls_due.ns

    cdef int begin_tick(self, uint64_t event) except -1:
        """Tell what the loop does, and record it as EVENT_TICK or EVENT_CALLS."""
        subscriber_check(self.subscriber)
        return tell_of_tick(self.subscriber, self.subscriber.words.words, event, monotonic_ns())

    cdef int end_tick(self) except -1:
        subscriber_check(self.subscriber)
        return try_to_store(self.subscriber.words.words + OUT_ACTIVITY, ACTIVITY_IDLE)

    cdef int tick(self) except -1:
        """Tick, and set when the next tick is due."""
        self.begin_tick(EVENT_TICK)
        late_ns = monotonic_ns() - self.times.due_ns
        begun_ns = monotonic_ns()
        self.module.tick()
        subscriber_check(self.subscriber)
        words = self.subscriber.words.words
        count_tick(words, late_ns, monotonic_ns() - begun_ns, &self.times.ticks)
        self.schedule()
        return self.end_tick()

    cdef int schedule(self) except -1:
        """Set when the next tick is due."""
        period_ns = self.period_ns()
        if period_ns == NO_PERIOD:
            return 0
        if period_ns == ODD_PERIOD:
            self.ticks.schedule()
            return 0
        times = self.times
        times.due_ns += period_ns
        behind_ns = now_ns() - times.due_ns
        if behind_ns <= period_ns:
            return 0
        missed = behind_ns // period_ns
        times.due_ns += missed * period_ns
        times.missed += missed
        subscriber_check(self.subscriber)  # the period may be a property
        return try_to_store(self.subscriber.words.words + OUT_TICKS_MISSED, times.missed)

    cdef int wait(self, int64_t period_ns) except -1:
        """Wait for messages, for the next tick or for calls."""
        prepare_history(self.subscriber)
        wait_ns = self.max_wait_ns
        if period_ns != NO_PERIOD:
            wait_ns = sooner(wait_ns, self.times.due_ns)
        due_ns = self.calls_due_ns()
        if due_ns != NEVER_NS:
            wait_ns = sooner(wait_ns, due_ns)
        if not self.wakeup.wait_ns(wait_ns):
            return 0
        # The messages that a publisher waits for have been released, or a thread has asked for a tick.
        if self.outbox.awaits_room and self.outbox.room_was_made():
            self.times.due_ns = now_ns()
        if self.module._is_tick_awaited:
            self.module._is_tick_awaited = False
            self.times.due_ns = now_ns()
        return 0
