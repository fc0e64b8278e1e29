/* The Python type Semaphore: what robbie_mp/transport/wakeup.py waits on and posts to. */
#include "wakeup_bindings.h"
#include "native.h"
#include <errno.h>
#include <math.h>

struct semaphore_object {
    PyObject_HEAD
    struct wakeup wakeup;
    bool is_disowned;
};

static const double MAX_TIMEOUT_S = 1e9; /* 30 years: longer ones do not fit into 64 bits of ns */

static int check_open(struct semaphore_object *self)
{
    if (self->wakeup.semaphore != NULL)
        return 0;
    if (self->is_disowned)
        raise_forked_process();
    else
        PyErr_SetString(PyExc_ValueError, "this semaphore is closed");
    return -1;
}

static PyObject *semaphore_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"name", NULL};
    PyObject *name;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O&", names, PyUnicode_FSConverter, &name))
        return NULL;
    struct semaphore_object *self = (struct semaphore_object *)type->tp_alloc(type, 0);
    if (self != NULL) {
        int error = wakeup_open(&self->wakeup, PyBytes_AS_STRING(name));
        if (error != 0) {
            errno = error;
            PyErr_SetFromErrno(PyExc_OSError);
            Py_CLEAR(self);
        }
    }
    Py_DECREF(name);
    return (PyObject *)self;
}

static void semaphore_dealloc(struct semaphore_object *self)
{
    wakeup_close(&self->wakeup);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *semaphore_post(struct semaphore_object *self, PyObject *Py_UNUSED(ignored))
{
    if (check_open(self) != 0)
        return NULL;
    wakeup_post(&self->wakeup);
    Py_RETURN_NONE;
}

/* Convert a time-out in s, or None, to ns. */
static int read_timeout(PyObject *timeout, int64_t *timeout_ns)
{
    *timeout_ns = WAIT_WITHOUT_LIMIT;
    if (timeout == Py_None)
        return 0;
    double seconds = PyFloat_AsDouble(timeout);
    if (seconds == -1.0 && PyErr_Occurred())
        return -1;
    if (isnan(seconds)) {
        PyErr_SetString(PyExc_ValueError, "a time-out must be a number of seconds");
        return -1;
    }
    *timeout_ns = (int64_t)(fmin(fmax(seconds, 0.0), MAX_TIMEOUT_S) * 1e9);
    return 0;
}

int wait_for_post(struct wakeup *wakeup, int64_t timeout_ns)
{
    if (wakeup_take(wakeup))
        return 1;
    if (timeout_ns == 0)
        return 0;
    int error;
    wakeup_begin_wait(wakeup);
    Py_BEGIN_ALLOW_THREADS
    error = wakeup_wait(wakeup, timeout_ns);
    Py_END_ALLOW_THREADS
    wakeup_end_wait(wakeup);
    if (error == 0)
        return 1;
    if (error == ETIMEDOUT)
        return 0;
    if (error == EINTR) /* the caller looks at what the signal's handler has changed */
        return PyErr_CheckSignals() != 0 ? -1 : 0;
    errno = error;
    PyErr_SetFromErrno(PyExc_OSError);
    return -1;
}

static PyObject *semaphore_wait(struct semaphore_object *self, PyObject *timeout)
{
    int64_t timeout_ns;
    if (check_open(self) != 0 || read_timeout(timeout, &timeout_ns) != 0)
        return NULL;
    const int woken = wait_for_post(&self->wakeup, timeout_ns);
    return woken < 0 ? NULL : PyBool_FromLong(woken);
}

static PyObject *semaphore_close(struct semaphore_object *self, PyObject *Py_UNUSED(ignored))
{
    wakeup_close(&self->wakeup);
    Py_RETURN_NONE;
}

static PyObject *semaphore_disown(struct semaphore_object *self, PyObject *Py_UNUSED(ignored))
{
    self->wakeup.semaphore = self->wakeup.waited_on = NULL; /* open: the process that forked this one uses it */
    self->is_disowned = true;
    Py_RETURN_NONE;
}

static PyObject *semaphore_value(struct semaphore_object *self, void *Py_UNUSED(closure))
{
    int posts;
    if (check_open(self) != 0)
        return NULL;
    if (sem_getvalue(self->wakeup.semaphore, &posts) != 0)
        return PyErr_SetFromErrno(PyExc_OSError);
    return PyLong_FromLong(posts);
}

static PyMethodDef semaphore_methods[] = {
    {"post", (PyCFunction)semaphore_post, METH_NOARGS, "Wake the process that waits."},
    {"wait", (PyCFunction)semaphore_wait, METH_O,
     "Wait for a post and take all posts; False after the time-out in s (None: no limit) or a signal."},
    {"close", (PyCFunction)semaphore_close, METH_NOARGS, "Close this process's handle."},
    {"disown", (PyCFunction)semaphore_disown, METH_NOARGS, "Refuse every use in a forked process."},
    {0},
};

static PyGetSetDef semaphore_attributes[] = {
    {"value", (getter)semaphore_value, NULL, "Posts that nobody has taken yet.", NULL},
    {0},
};

static PyTypeObject semaphore_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp._hot.native.Semaphore",
    .tp_doc = "An existing named semaphore, by its name with the leading slash.",
    .tp_basicsize = sizeof(struct semaphore_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = semaphore_new,
    .tp_dealloc = (destructor)semaphore_dealloc,
    .tp_methods = semaphore_methods,
    .tp_getset = semaphore_attributes,
};

struct wakeup *wakeup_of(PyObject *callable)
{
    if (!PyCFunction_Check(callable) ||
        PyCFunction_GET_FUNCTION(callable) != (PyCFunction)semaphore_post)
        return NULL;
    return &((struct semaphore_object *)PyCFunction_GET_SELF(callable))->wakeup;
}

int add_wakeup_types(PyObject *module)
{
    if (PyModule_AddType(module, &semaphore_type) != 0)
        return -1;
    return PyModule_AddObjectRef(module, "WAITS_BY_MONOTONIC_CLOCK",
                                 WAITS_BY_MONOTONIC_CLOCK ? Py_True : Py_False);
}
