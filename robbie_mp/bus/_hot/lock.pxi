# The Python type Lock: a reentrant lock, as threading.RLock.

cdef extern from "pythread.h":
    ctypedef void *PyThread_type_lock
    PyThread_type_lock PyThread_allocate_lock()
    void PyThread_free_lock(PyThread_type_lock lock)
    void PyThread_release_lock(PyThread_type_lock lock)

cdef extern from *:
    """
    #include "lock.h"
    """
    bint lock_is_elsewhere(Lock lock)
    int lock_take(Lock lock) except -1
    void lock_give(Lock lock)


cdef public class Lock [object lock_object, type lock_type]:
    """A reentrant lock at which C code can look."""

    # They change only under the GIL.
    cdef PyThread_type_lock lock
    cdef unsigned long owner
    cdef unsigned long depth  # how often its owner has taken it; 0: it is free

    def __cinit__(self):
        self.lock = PyThread_allocate_lock()
        if self.lock == NULL:
            raise MemoryError

    def __dealloc__(self):
        if self.lock != NULL:
            if self.depth != 0:
                PyThread_release_lock(self.lock)
            PyThread_free_lock(self.lock)

    def acquire(self):
        """Take the lock, waiting for it if need be."""
        lock_take(self)
        return True

    def release(self):
        """Give the lock back."""
        if self.depth == 0 or lock_is_elsewhere(self):
            raise RuntimeError("cannot release a lock that this thread does not hold")
        lock_give(self)

    def __enter__(self):
        return self.acquire()

    def __exit__(self, _, __, ___):
        self.release()
