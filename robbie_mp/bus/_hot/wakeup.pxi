# The Python type Wakeup: what robbie_mp/bus/transport/wakeup.py waits on and posts to.
from cpython.exc cimport PyErr_CheckSignals
from libc.errno cimport EPERM

cdef extern from "wakeup.h":
    enum: WAIT_WITHOUT_LIMIT
    struct wakeup:
        shared_word *posts
        shared_word *waited_on
        shared_word *asleep
        uint32_t seen
        int waiters
    void wakeup_post(wakeup *wakeup)
    bint wakeup_take(wakeup *wakeup)
    void wakeup_begin_wait(wakeup *wakeup)
    void wakeup_end_wait(wakeup *wakeup)
    int wakeup_wait(wakeup *wakeup, int64_t timeout_ns) nogil
    int wakeup_nap(int64_t nap_ns) nogil

cdef double MAX_TIMEOUT_S = 1e9  # 30 years: longer ones do not fit into 64 bits of ns


cdef class Wakeup:
    """A word of shared memory by which one process wakes another."""

    cdef wakeup wakeup
    cdef held_words posts, who_sleeps
    cdef bint is_disowned
    cdef public int64_t patience_ns

    def __cinit__(self, posts, asleep=None, Py_ssize_t at=0):
        hold_words(&self.posts, posts, True)
        if self.posts.count == 0:
            raise ValueError("posts need a word")
        if asleep is not None:
            hold_words(&self.who_sleeps, asleep, False)
            if not 0 <= at < self.who_sleeps.count:
                raise ValueError("the word that says who sleeps does not lie in its memory")
            self.wakeup.asleep = self.who_sleeps.words + at
        self.wakeup.posts = self.posts.words

    def __dealloc__(self):
        self.let_go()

    cdef void let_go(self) noexcept:
        self.wakeup.asleep = NULL
        release_words(&self.posts)
        release_words(&self.who_sleeps)

    cdef int check_open(self) except -1:
        if self.wakeup.posts != NULL:
            return 0
        if self.is_disowned:
            raise_forked_process()
        raise ValueError("this wake-up is closed")

    def post(self):
        """Wake the process that waits."""
        self.check_open()
        wakeup_post(&self.wakeup)

    def wait(self, timeout_s, /):
        """Wait for a post and take all posts; False after the time-out in s (None: no limit) or a signal."""
        cdef int64_t timeout_ns = WAIT_WITHOUT_LIMIT
        cdef double seconds
        if timeout_s is not None:
            seconds = timeout_s
            if seconds != seconds:
                raise ValueError("a time-out must be a number of seconds")
            timeout_ns = <int64_t>(min(max(seconds, 0.0), MAX_TIMEOUT_S) * 1e9)
        return bool(self.wait_ns(timeout_ns))

    cdef bint wait_ns(self, int64_t timeout_ns) except -1:
        """Wait for a post and take all posts; False after the time-out or a signal. Other threads run meanwhile."""
        cdef int error
        cdef bint is_limited = timeout_ns >= 0
        cdef int64_t nap_ns = min(self.patience_ns, timeout_ns) if is_limited else self.patience_ns
        if nap_ns > 0:
            with nogil:
                error = wakeup_nap(nap_ns)
            if error == EINTR:
                PyErr_CheckSignals()
                return False
            if is_limited:
                timeout_ns -= nap_ns
        self.check_open()  # what Python did since the caller looked may have closed it
        if wakeup_take(&self.wakeup):
            return True
        if timeout_ns == 0:
            return False
        error = self.sleep(timeout_ns)
        if error == EINTR:
            PyErr_CheckSignals()  # the caller looks at what the signal's handler has changed
        elif error not in (0, ETIMEDOUT):
            raise_os_error(error)
        return error == 0

    cdef int sleep(self, int64_t timeout_ns) noexcept:
        """Wait for a post without the GIL and take all posts; 0, or the error's number as of `wakeup_wait`."""
        cdef int error
        if self.wakeup.asleep != NULL and self.who_sleeps.buffer.readonly:
            return EPERM  # it is another process that sleeps here
        wakeup_begin_wait(&self.wakeup)
        with nogil:
            error = wakeup_wait(&self.wakeup, timeout_ns)
        wakeup_end_wait(&self.wakeup)
        if self.wakeup.posts == NULL and self.wakeup.waiters == 0:  # it was closed meanwhile
            self.let_go()
        return error

    def close(self):
        """Let go of the memory."""
        if self.wakeup.waiters == 0:
            self.let_go()
        else:
            wakeup_post(&self.wakeup)  # the threads that wait end their waits, and the last one lets go
        self.wakeup.posts = NULL

    def disown(self):
        """Refuse every use in a forked process."""
        # It stays mapped: the process that forked this one uses it.
        self.wakeup.posts = self.wakeup.waited_on = NULL
        self.is_disowned = True

    @property
    def has_posts(self):
        """Whether there are posts that nobody has taken yet."""
        self.check_open()
        return <uint32_t>load(self.wakeup.posts) != self.wakeup.seen


cdef int raise_os_error(int error) except -1:
    global errno
    errno = error
    PyErr_SetFromErrno(OSError)
    return -1


cdef Wakeup posted_by(callable):
    """Return the wake-up to which a callable posts; None if it is any other callable."""
    owner = getattr(callable, "__self__", None)
    return owner if isinstance(owner, Wakeup) and callable == owner.post else None


cdef public wakeup *wakeup_of(object callable) noexcept:
    """The same for C: it lives as long as the callable; NULL: it is any other one."""
    owner = posted_by(callable)
    return NULL if owner is None else &owner.wakeup
