/* A reentrant lock, as threading.RLock. */
#include "lock.h"

bool lock_is_elsewhere(const struct lock_object *lock)
{
    return lock->depth != 0 && lock->owner != PyThread_get_thread_ident();
}

int lock_take(struct lock_object *lock)
{
    const unsigned long me = PyThread_get_thread_ident();
    if (lock->depth != 0 && lock->owner == me) {
        lock->depth++;
        return 0;
    }
    PyLockStatus got = PyThread_acquire_lock_timed(lock->lock, 0, 0);
    while (got != PY_LOCK_ACQUIRED) {
        Py_BEGIN_ALLOW_THREADS
        got = PyThread_acquire_lock_timed(lock->lock, -1, 1);
        Py_END_ALLOW_THREADS
        if (got == PY_LOCK_INTR && PyErr_CheckSignals() != 0)
            return -1;
    }
    lock->owner = me;
    lock->depth = 1;
    return 0;
}

void lock_give(struct lock_object *lock)
{
    if (--lock->depth == 0)
        PyThread_release_lock(lock->lock);
}
