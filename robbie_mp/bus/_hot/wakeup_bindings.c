/* The Python type Wakeup: what robbie_mp/bus/transport/wakeup.py waits on and posts to. */
#include "wakeup_bindings.h"
#include "native.h"
#include <errno.h>
#include <math.h>
#include <stddef.h>

struct wakeup_object {
    PyObject_HEAD
    struct wakeup wakeup;
    struct held_words posts, asleep;
    bool is_disowned;
};

static const double MAX_TIMEOUT_S = 1e9; /* 30 years: longer ones do not fit into 64 bits of ns */

static int check_open(struct wakeup_object *self)
{
    if (self->wakeup.posts != NULL)
        return 0;
    if (self->is_disowned)
        raise_forked_process();
    else
        PyErr_SetString(PyExc_ValueError, "this wake-up is closed");
    return -1;
}

static void let_go(struct wakeup_object *self)
{
    self->wakeup.asleep = NULL;
    release_words(&self->posts);
    release_words(&self->asleep);
}

/* Hold the word that says whether the process that waits sleeps; 0, or -1 with an exception. */
static int hold_asleep(struct wakeup_object *self, PyObject *words, Py_ssize_t at)
{
    if (words == Py_None)
        return 0;
    if (hold_words(&self->asleep, words, false) != 0)
        return -1;
    if (at < 0 || at >= self->asleep.count) {
        PyErr_SetString(PyExc_ValueError, "the word that says who sleeps does not lie in its memory");
        return -1;
    }
    self->wakeup.asleep = self->asleep.words + at;
    return 0;
}

static PyObject *wakeup_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"posts", "asleep", "at", NULL};
    PyObject *posts, *asleep = Py_None;
    Py_ssize_t at = 0;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O|On", names, &posts, &asleep, &at))
        return NULL;
    struct wakeup_object *self = (struct wakeup_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    if (hold_words(&self->posts, posts, true) != 0 || hold_asleep(self, asleep, at) != 0) {
        Py_DECREF(self);
        return NULL;
    }
    if (self->posts.count == 0) {
        Py_DECREF(self);
        PyErr_SetString(PyExc_ValueError, "posts need a word");
        return NULL;
    }
    self->wakeup.posts = self->posts.words;
    return (PyObject *)self;
}

static void close_wakeup(struct wakeup_object *self)
{
    if (self->wakeup.waiters == 0)
        let_go(self);
    else
        wakeup_post(&self->wakeup); /* the threads that wait end their waits, and the last one lets go */
    self->wakeup.posts = NULL;
}

static void wakeup_dealloc(struct wakeup_object *self)
{
    close_wakeup(self);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *post(struct wakeup_object *self, PyObject *Py_UNUSED(ignored))
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

int sleep_until_post(struct wakeup *wakeup, int64_t timeout_ns)
{
    struct wakeup_object *self = (struct wakeup_object *)((char *)wakeup - offsetof(struct wakeup_object, wakeup));
    int error;
    if (wakeup->asleep != NULL && self->asleep.buffer.readonly)
        return EPERM; /* it is another process that sleeps here */
    wakeup_begin_wait(wakeup);
    Py_BEGIN_ALLOW_THREADS
    error = wakeup_wait(wakeup, timeout_ns);
    Py_END_ALLOW_THREADS
    wakeup_end_wait(wakeup);
    if (wakeup->posts == NULL && wakeup->waiters == 0) /* it was closed meanwhile */
        let_go(self);
    return error;
}

int wait_for_post(struct wakeup *wakeup, int64_t timeout_ns)
{
    if (wakeup_take(wakeup))
        return 1;
    if (timeout_ns == 0)
        return 0;
    const int error = sleep_until_post(wakeup, timeout_ns);
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

static PyObject *wait_in_python(struct wakeup_object *self, PyObject *timeout)
{
    int64_t timeout_ns;
    if (check_open(self) != 0 || read_timeout(timeout, &timeout_ns) != 0)
        return NULL;
    const int woken = wait_for_post(&self->wakeup, timeout_ns);
    return woken < 0 ? NULL : PyBool_FromLong(woken);
}

static PyObject *close_in_python(struct wakeup_object *self, PyObject *Py_UNUSED(ignored))
{
    close_wakeup(self);
    Py_RETURN_NONE;
}

static PyObject *disown(struct wakeup_object *self, PyObject *Py_UNUSED(ignored))
{
    self->wakeup.posts = self->wakeup.waited_on = NULL; /* mapped: the process that forked this one uses it */
    self->is_disowned = true;
    Py_RETURN_NONE;
}

static PyObject *get_has_posts(struct wakeup_object *self, void *Py_UNUSED(closure))
{
    if (check_open(self) != 0)
        return NULL;
    return PyBool_FromLong((uint32_t)load(self->wakeup.posts) != self->wakeup.seen);
}

static PyMethodDef wakeup_methods[] = {
    {"post", (PyCFunction)post, METH_NOARGS, "Wake the process that waits."},
    {"wait", (PyCFunction)wait_in_python, METH_O,
     "Wait for a post and take all posts; False after the time-out in s (None: no limit) or a signal."},
    {"close", (PyCFunction)close_in_python, METH_NOARGS, "Let go of the memory."},
    {"disown", (PyCFunction)disown, METH_NOARGS, "Refuse every use in a forked process."},
    {0},
};

static PyGetSetDef wakeup_attributes[] = {
    {"has_posts", (getter)get_has_posts, NULL, "Whether there are posts that nobody has taken yet.", NULL},
    {0},
};

static PyTypeObject wakeup_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Wakeup",
    .tp_doc = "A word of shared memory by which one process wakes another.",
    .tp_basicsize = sizeof(struct wakeup_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = wakeup_new,
    .tp_dealloc = (destructor)wakeup_dealloc,
    .tp_methods = wakeup_methods,
    .tp_getset = wakeup_attributes,
};

struct wakeup *wakeup_of(PyObject *callable)
{
    if (!PyCFunction_Check(callable) || PyCFunction_GET_FUNCTION(callable) != (PyCFunction)post)
        return NULL;
    return &((struct wakeup_object *)PyCFunction_GET_SELF(callable))->wakeup;
}

int add_wakeup_types(PyObject *module)
{
    return PyModule_AddType(module, &wakeup_type);
}
