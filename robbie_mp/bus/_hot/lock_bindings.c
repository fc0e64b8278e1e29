/* The Python type Lock: a reentrant lock, as threading.RLock. */
#include "lock_bindings.h"

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

static PyObject *lock_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "", (char *[]){NULL}))
        return NULL;
    struct lock_object *self = (struct lock_object *)type->tp_alloc(type, 0);
    if (self != NULL && (self->lock = PyThread_allocate_lock()) == NULL) {
        Py_DECREF(self);
        return PyErr_NoMemory();
    }
    return (PyObject *)self;
}

static void lock_dealloc(struct lock_object *self)
{
    if (self->lock != NULL) {
        if (self->depth != 0)
            PyThread_release_lock(self->lock);
        PyThread_free_lock(self->lock);
    }
    Py_TYPE(self)->tp_free(self);
}

static PyObject *lock_acquire(struct lock_object *self, PyObject *Py_UNUSED(ignored))
{
    if (lock_take(self) != 0)
        return NULL;
    Py_RETURN_TRUE;
}

static PyObject *lock_release(struct lock_object *self, PyObject *Py_UNUSED(ignored))
{
    if (self->depth == 0 || lock_is_elsewhere(self)) {
        PyErr_SetString(PyExc_RuntimeError, "cannot release a lock that this thread does not hold");
        return NULL;
    }
    lock_give(self);
    Py_RETURN_NONE;
}

static PyObject *lock_exit(struct lock_object *self, PyObject *const *Py_UNUSED(error), Py_ssize_t Py_UNUSED(count))
{
    return lock_release(self, NULL);
}

static PyMethodDef lock_methods[] = {
    {"acquire", (PyCFunction)lock_acquire, METH_NOARGS, "Take the lock, waiting for it if need be."},
    {"release", (PyCFunction)lock_release, METH_NOARGS, "Give the lock back."},
    {"__enter__", (PyCFunction)lock_acquire, METH_NOARGS, "Take the lock."},
    {"__exit__", (PyCFunction)(void (*)(void))lock_exit, METH_FASTCALL, "Give the lock back."},
    {0},
};

PyTypeObject lock_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Lock",
    .tp_doc = "A reentrant lock at which C code can look.",
    .tp_basicsize = sizeof(struct lock_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = lock_new,
    .tp_dealloc = (destructor)lock_dealloc,
    .tp_methods = lock_methods,
};

int add_lock_type(PyObject *module)
{
    return PyModule_AddType(module, &lock_type);
}
