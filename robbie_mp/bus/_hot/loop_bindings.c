/* The Python types Loop and TickTimes: what robbie_mp/module/loop.py and ticks.py leave to C. */
#include "subscriber_bindings.h"
#include "wakeup_bindings.h"
#include "clock.h"
#include "figures.h"
#include "layout.h"
#include <math.h>
#include <structmember.h>

/* Periods of which C computes the next tick; Python has others, and those that are no period. */
static const double MIN_PERIOD_NS = 1.0, MAX_PERIOD_NS = 1e17;

/* As in calls/due.py. */
static const long long NEVER_NS = INT64_MAX;

struct tick_times_object {
    PyObject_HEAD
    long long due_ns;
    unsigned long long ticks, missed;
};

struct loop_object {
    PyObject_HEAD
    struct subscriber_object *subscriber;
    PyObject *runner;
    PyObject *inbox;
    PyObject *outbox;
    PyObject *module;
    PyObject *calls;
    PyObject *calls_due; /* a Due of calls/due.py */
    PyObject *ticks;
    struct tick_times_object *times;
    PyObject *wake;
    struct wakeup *wakeup; /* to which `wake` posts */
    long long max_wait_ns;
};

/* Names of attributes, made once. */
static PyObject *name_awaits_room, *name_due, *name_ends, *name_is_tick_awaited, *name_ns, *name_period,
    *name_room_was_made, *name_run, *name_schedule, *name_tick;

/* -- ticks.py ----------------------------------------------------------------------------------------------- */

static PyMemberDef tick_times_members[] = {
    {"due_ns", T_LONGLONG, offsetof(struct tick_times_object, due_ns), 0, "When the next tick is due, in ns."},
    {"ticks", T_ULONGLONG, offsetof(struct tick_times_object, ticks), 0, "Number of ticks so far."},
    {"missed", T_ULONGLONG, offsetof(struct tick_times_object, missed), 0, "Number of ticks that were skipped."},
    {0},
};

static PyTypeObject tick_times_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.TickTimes",
    .tp_doc = "When the next tick of a module is due, and how many there were.",
    .tp_basicsize = sizeof(struct tick_times_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_members = tick_times_members,
};

enum period { PERIOD_NONE, PERIOD_SET, PERIOD_ODD, PERIOD_ERROR };

/* Read the module's period. PERIOD_ODD: Python must do what depends on it; PERIOD_ERROR: an exception is set. */
static enum period read_period(const struct loop_object *self, long long *period_ns)
{
    PyObject *period = PyObject_GetAttr(self->module, name_period);
    if (period == NULL)
        return PERIOD_ERROR;
    const bool is_set = period != Py_None;
    double ns = 0.0;
    if (PyFloat_Check(period))
        ns = PyFloat_AS_DOUBLE(period) * 1e9;
    else if (PyLong_Check(period))
        ns = PyLong_AsDouble(period) * 1e9;
    Py_DECREF(period);
    PyErr_Clear(); /* of an int that is too large */
    if (!is_set)
        return PERIOD_NONE;
    if (!(ns >= MIN_PERIOD_NS && ns <= MAX_PERIOD_NS))
        return PERIOD_ODD;
    *period_ns = (long long)nearbyint(ns); /* as Python's round: halves to even */
    return PERIOD_SET;
}

/* Set when the next tick is due; 1, or -1 with an exception. */
static int schedule(struct loop_object *self)
{
    struct tick_times_object *times = self->times;
    long long period_ns;
    switch (read_period(self, &period_ns)) {
    case PERIOD_NONE:
        return 1;
    case PERIOD_SET:
        break;
    case PERIOD_ODD: {
        PyObject *result = PyObject_CallMethodNoArgs(self->ticks, name_schedule);
        Py_XDECREF(result);
        return result == NULL ? -1 : 1;
    }
    default:
        return -1;
    }
    times->due_ns += period_ns;
    const long long behind_ns = (long long)monotonic_ns() - times->due_ns;
    if (behind_ns <= period_ns)
        return 1;
    const long long missed = behind_ns / period_ns;
    times->due_ns += missed * period_ns;
    times->missed += (unsigned long long)missed;
    MAY_DIE(return -1);
    store(subscriber_words(self->subscriber) + OUT_TICKS_MISSED, times->missed);
    return 1;
}

/* Tell what the loop does, and record it as EVENT_TICK or EVENT_CALLS. */
static int begin_tick(const struct loop_object *self, uint64_t event)
{
    shared_word *words = subscriber_words(self->subscriber);
    if (subscriber_check(self->subscriber) < 0)
        return -1;
    MAY_DIE(return -1);
    const uint64_t now_ns = monotonic_ns();
    store(words + OUT_ACTIVITY_SINCE_NS, now_ns);
    store(words + OUT_ACTIVITY, ACTIVITY_TICK);
    subscriber_record(self->subscriber, event, now_ns);
    return 1;
}

static int count_tick(struct loop_object *self, uint64_t late_ns, uint64_t begun_ns)
{
    shared_word *words = subscriber_words(self->subscriber);
    MAY_DIE(return -1);
    figures_record(words + OUT_TICK_FIGURES, late_ns, monotonic_ns() - begun_ns);
    store(words + OUT_TICKS, ++self->times->ticks);
    return 1;
}

static int end_tick(const struct loop_object *self)
{
    if (subscriber_check(self->subscriber) < 0)
        return -1;
    MAY_DIE(return -1);
    store(subscriber_words(self->subscriber) + OUT_ACTIVITY, ACTIVITY_IDLE);
    return 1;
}

/* Tick, and set when the next tick is due; 1, or -1 with an exception. */
static int run_tick(struct loop_object *self)
{
    if (begin_tick(self, EVENT_TICK) < 0)
        return -1;
    const uint64_t late_ns = monotonic_ns() - (uint64_t)self->times->due_ns, begun_ns = monotonic_ns();
    PyObject *result = PyObject_CallMethodNoArgs(self->module, name_tick);
    if (result == NULL)
        return -1;
    Py_DECREF(result);
    if (subscriber_check(self->subscriber) < 0 || count_tick(self, late_ns, begun_ns) < 0 || schedule(self) < 0)
        return -1;
    return end_tick(self);
}

/* -- loop.py ------------------------------------------------------------------------------------------------ */

/* Whether an attribute is true; -1 with an exception. */
static int is_true(PyObject *object, PyObject *name)
{
    PyObject *value = PyObject_GetAttr(object, name);
    const int truth = value == NULL ? -1 : PyObject_IsTrue(value);
    Py_XDECREF(value);
    return truth;
}

/* Whether the messages that a publisher waits for have been released; true only once; -1 with an exception. */
static int room_was_made(const struct loop_object *self)
{
    const int awaits_room = is_true(self->outbox, name_awaits_room);
    if (awaits_room <= 0)
        return awaits_room;
    PyObject *result = PyObject_CallMethodNoArgs(self->outbox, name_room_was_made);
    const int was_made = result == NULL ? -1 : PyObject_IsTrue(result);
    Py_XDECREF(result);
    return was_made;
}

/* Whether any thread has asked for a tick; true only once; -1 with an exception. */
static int tick_is_awaited(const struct loop_object *self)
{
    const int is_awaited = is_true(self->module, name_is_tick_awaited);
    if (is_awaited > 0 && PyObject_SetAttr(self->module, name_is_tick_awaited, Py_False) != 0)
        return -1;
    return is_awaited;
}

/* Make the next tick due now if a condition is true; 1, or -1 with an exception, as the condition may be. */
static int expedite_if(struct loop_object *self, int condition)
{
    if (condition > 0)
        self->times->due_ns = (long long)monotonic_ns();
    return condition < 0 ? -1 : 1;
}

/* Read when something is to be done for the module's calls; 0, or -1 with an exception. */
static int read_calls_due(const struct loop_object *self, long long *due_ns)
{
    PyObject *ns = PyObject_GetAttr(self->calls_due, name_ns);
    *due_ns = ns == NULL ? -1 : PyLong_AsLongLong(ns);
    Py_XDECREF(ns);
    return *due_ns == -1 && PyErr_Occurred() ? -1 : 0;
}

/* Whether something is to be done for the module's calls; -1 with an exception. */
static int are_calls_due(const struct loop_object *self)
{
    long long due_ns;
    if (read_calls_due(self, &due_ns) < 0)
        return -1;
    return due_ns != NEVER_NS && (long long)monotonic_ns() >= due_ns;
}

/* Do it; 1, or -1 with an exception. */
static int run_calls(struct loop_object *self)
{
    if (begin_tick(self, EVENT_CALLS) < 0)
        return -1;
    PyObject *result = PyObject_CallMethodNoArgs(self->calls, name_run);
    if (result == NULL)
        return -1;
    Py_DECREF(result);
    return end_tick(self);
}

static long long sooner(long long wait_ns, long long due_ns)
{
    const long long left_ns = due_ns - (long long)monotonic_ns();
    return left_ns < 0 ? 0 : left_ns < wait_ns ? left_ns : wait_ns;
}

/* Use the time before the wait for the history; 1, or -1 with an exception. */
static int prepare_history(const struct loop_object *self)
{
    MAY_DIE(return -1);
    subscriber_prepare_history(self->subscriber);
    return 1;
}

/* Wait for messages, for the next tick or for calls; 1, or -1 with an exception. */
static int wait_for_work(struct loop_object *self, bool has_period)
{
    if (prepare_history(self) < 0)
        return -1;
    long long wait_ns = self->max_wait_ns, calls_due_ns;
    if (has_period)
        wait_ns = sooner(wait_ns, self->times->due_ns);
    if (read_calls_due(self, &calls_due_ns) < 0)
        return -1;
    if (calls_due_ns != NEVER_NS)
        wait_ns = sooner(wait_ns, calls_due_ns);
    const int woken = wait_for_post(self->wakeup, wait_ns);
    if (woken <= 0)
        return woken < 0 ? -1 : 1;
    if (expedite_if(self, room_was_made(self)) < 0)
        return -1;
    return expedite_if(self, tick_is_awaited(self));
}

/* What a turn does after it has looked for a message; 1, or -1 with an exception. */
static int take_rest_of_turn(struct loop_object *self, enum period period, bool was_one)
{
    if (period == PERIOD_ERROR)
        return -1;
    long long period_ns;
    const int calls_due = are_calls_due(self);
    if (calls_due < 0)
        return -1;
    if (calls_due) {
        const int ends_before = was_one ? is_true(self->runner, name_ends) : 0;
        if (ends_before != 0)
            return ends_before;
        if (run_calls(self) < 0)
            return -1;
        const int ends = is_true(self->runner, name_ends);
        if (ends != 0)
            return ends;
        period = read_period(self, &period_ns);
    }
    if (period == PERIOD_ERROR || period == PERIOD_ODD)
        return period == PERIOD_ODD ? 1 : -1; /* with an odd one, the next turn is not mine */
    if (period == PERIOD_SET && (long long)monotonic_ns() >= self->times->due_ns) {
        const int ends = was_one ? is_true(self->runner, name_ends) : 0;
        return ends != 0 ? ends : run_tick(self);
    }
    return was_one ? 1 : wait_for_work(self, period == PERIOD_SET);
}

/* One turn; 1, 0 if this is not mine, or -1 with an exception. */
static int take_turn(struct loop_object *self)
{
    long long period_ns;
    enum period period = read_period(self, &period_ns);
    if (period == PERIOD_ERROR)
        return -1;
    if (period == PERIOD_ODD || self->wakeup->posts == NULL)
        return 0;
    switch (subscriber_handle_next(self->subscriber, self->inbox)) {
    case HANDLED_NOT_MINE:
        return 0;
    case HANDLED_NONE:
        return take_rest_of_turn(self, period, false);
    case HANDLED_ONE:
        period = read_period(self, &period_ns); /* the handler may have changed it */
        return take_rest_of_turn(self, period, true);
    default:
        return -1;
    }
}

static PyObject *turn(struct loop_object *self, PyObject *Py_UNUSED(none))
{
    const int done = take_turn(self);
    if (done < 0)
        return NULL;
    return PyBool_FromLong(done);
}

static PyObject *loop_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"runner", "subscriber", "inbox", "outbox", "module", "calls", "ticks", "times", "wake",
                            "max_wait_ns", NULL};
    PyObject *runner, *subscriber, *inbox, *outbox, *module, *calls, *ticks, *times, *wake;
    long long max_wait_ns;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "OO!OOOOOO!OL", names, &runner, &subscriber_type, &subscriber, &inbox,
                                     &outbox, &module, &calls, &ticks, &tick_times_type, &times, &wake,
                                     &max_wait_ns))
        return NULL;
    if (wakeup_of(wake) == NULL) {
        PyErr_SetString(PyExc_TypeError, "expected the post of a wake-up in C");
        return NULL;
    }
    PyObject *calls_due = PyObject_GetAttr(calls, name_due);
    if (calls_due == NULL)
        return NULL;
    struct loop_object *self = (struct loop_object *)type->tp_alloc(type, 0);
    if (self == NULL) {
        Py_DECREF(calls_due);
        return NULL;
    }
    self->subscriber = (struct subscriber_object *)Py_NewRef(subscriber);
    self->runner = Py_NewRef(runner);
    self->inbox = Py_NewRef(inbox);
    self->outbox = Py_NewRef(outbox);
    self->module = Py_NewRef(module);
    self->calls = Py_NewRef(calls);
    self->calls_due = calls_due;
    self->ticks = Py_NewRef(ticks);
    self->times = (struct tick_times_object *)Py_NewRef(times);
    self->wake = Py_NewRef(wake);
    self->wakeup = wakeup_of(wake);
    self->max_wait_ns = max_wait_ns;
    return (PyObject *)self;
}

static int loop_traverse(struct loop_object *self, visitproc visit, void *arg)
{
    Py_VISIT(self->subscriber);
    Py_VISIT(self->runner);
    Py_VISIT(self->inbox);
    Py_VISIT(self->outbox);
    Py_VISIT(self->module);
    Py_VISIT(self->calls);
    Py_VISIT(self->calls_due);
    Py_VISIT(self->ticks);
    Py_VISIT(self->wake);
    return 0;
}

static void loop_dealloc(struct loop_object *self)
{
    PyObject_GC_UnTrack(self);
    Py_XDECREF(self->subscriber);
    Py_XDECREF(self->runner);
    Py_XDECREF(self->inbox);
    Py_XDECREF(self->outbox);
    Py_XDECREF(self->module);
    Py_XDECREF(self->calls);
    Py_XDECREF(self->calls_due);
    Py_XDECREF(self->ticks);
    Py_XDECREF(self->times);
    Py_XDECREF(self->wake);
    Py_TYPE(self)->tp_free(self);
}

static PyMethodDef loop_methods[] = {
    {"turn", (PyCFunction)turn, METH_NOARGS,
     "Handle at most one message and run at most one tick, or wait for either; False if this is not mine."},
    {0},
};

static PyTypeObject loop_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Loop",
    .tp_doc = "The common form of a turn of a module's loop.",
    .tp_basicsize = sizeof(struct loop_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = loop_new,
    .tp_dealloc = (destructor)loop_dealloc,
    .tp_traverse = (traverseproc)loop_traverse,
    .tp_methods = loop_methods,
};

int add_loop_types(PyObject *module)
{
    const struct {
        PyObject **name;
        const char *text;
    } names[] = {
        {&name_awaits_room, "awaits_room"},
        {&name_due, "due"},
        {&name_ends, "ends"},
        {&name_is_tick_awaited, "_is_tick_awaited"},
        {&name_ns, "ns"},
        {&name_period, "period_s"},
        {&name_room_was_made, "room_was_made"},
        {&name_run, "run"},
        {&name_schedule, "schedule"},
        {&name_tick, "tick"},
    };
    for (size_t index = 0; index < sizeof(names) / sizeof(names[0]); index++)
        if (*names[index].name == NULL && (*names[index].name = PyUnicode_InternFromString(names[index].text)) == NULL)
            return -1;
    if (PyModule_AddType(module, &tick_times_type) != 0)
        return -1;
    return PyModule_AddType(module, &loop_type);
}
