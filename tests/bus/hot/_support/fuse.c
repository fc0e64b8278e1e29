/* The test build's shared memory: it counts and writes down every store, and lets a process die before one.
 *
 * Python and C store into `Words` through the same `before_store`, so that their stores are comparable. Each
 * words object has one writing process, hence one fuse. A copy of all that was stored tells whether anything
 * was stored in another way.
 *
 * Memory that nobody uses any more is kept for the next words of the same length, because most of the time of a
 * short history would go into getting and clearing memory. Only its pages that were stored into are cleared. */
#include "clock.h"
#include "native.h"
#include <stdlib.h>
#include <string.h>
#include <structmember.h>

enum { WAKE = UINT32_MAX, PAGE_WORDS = 512 };

/* AddressSanitizer must see who uses memory that was given back. */
#ifdef __SANITIZE_ADDRESS__
enum { KEEPS_MEMORY = 0 };
#else
enum { KEEPS_MEMORY = 1 };
#endif

struct entry {
    uint32_t words; /* which; or WAKE */
    uint32_t index;
    uint64_t value;
};

static struct {
    struct entry *entries;
    size_t count, capacity;
    bool is_on;
} trace;

typedef struct {
    PyObject_HEAD
    PyObject *died;     /* the exception of a death */
    PyObject *deaths;   /* list: how many stores each incarnation in turn lives to see */
    PyObject *on_store; /* None, or told the number of each store before it */
    unsigned long long stores;
    uint64_t burns_at;
} Fuse;

struct region {
    shared_word *words;
    uint64_t *stored;
    bool *is_used; /* for each page: whether it was stored into */
    Py_ssize_t count;
    uint32_t number;
    uint64_t traces; /* how many had begun when it was made */
    Fuse *fuse;         /* of the one process that stores here; NULL: nobody counts */
    PyObject *on_store; /* None, or told index, old and new value of each store before it */
    Py_ssize_t users;
    struct region *next, *previous;
};

static struct region *regions;
static struct region *unused; /* a list by `next` only */
static uint32_t next_number;
static uint64_t traces;
static uint32_t hidden_words = UINT32_MAX, hidden_index; /* a word whose values are times, which do not repeat */
static struct way_out *innermost;
static Fuse *died_of;
static unsigned long long unguarded; /* stores where nobody had said MAY_DIE */

void open_way_out(struct way_out *way_out)
{
    way_out->outer = innermost;
    innermost = way_out;
}

void close_way_out(struct way_out *way_out)
{
    innermost = way_out->outer;
}

void raise_died(void)
{
    PyErr_SetNone(died_of->died);
}

static void note(uint32_t words, uint32_t index, uint64_t value)
{
    if (!trace.is_on)
        return;
    if (trace.count == trace.capacity) {
        trace.capacity = trace.capacity ? 2 * trace.capacity : 4096;
        trace.entries = realloc(trace.entries, trace.capacity * sizeof(struct entry));
        if (trace.entries == NULL)
            Py_FatalError("no memory for the trace");
    }
    const bool is_hidden = words == hidden_words && index == hidden_index;
    trace.entries[trace.count++] = (struct entry){words, index, is_hidden ? 0 : value};
}

static void tell(PyObject *listener, PyObject *arguments)
{
    PyObject *result = arguments == NULL ? NULL : PyObject_Call(listener, arguments, NULL);
    if (result == NULL)
        PyErr_WriteUnraisable(listener);
    Py_XDECREF(arguments);
    Py_XDECREF(result);
}

static struct region *region_of(const shared_word *place)
{
    for (struct region *region = regions; region != NULL; region = region->next)
        if (place >= region->words && place < region->words + region->count)
            return region;
    return NULL;
}

void before_store(shared_word *place, uint64_t value)
{
    struct region *region = region_of(place);
    if (region == NULL)
        return; /* memory that no test watches */
    uint64_t index = (uint64_t)(place - region->words);
    Fuse *fuse = region->fuse;
    if (innermost == NULL)
        unguarded++;
    if (fuse != NULL) {
        if (fuse->on_store != Py_None)
            tell(fuse->on_store, Py_BuildValue("(K)", fuse->stores));
        if (fuse->stores >= fuse->burns_at) {
            if (innermost == NULL)
                Py_FatalError("a process is to die before a store of C without MAY_DIE");
            died_of = fuse;
            longjmp(innermost->jump, 1);
        }
        fuse->stores++;
    }
    if (region->on_store != Py_None)
        tell(region->on_store, Py_BuildValue("(KKK)", index, load(place), value));
    region->stored[index] = value;
    region->is_used[index / PAGE_WORDS] = true;
    note(region->number, (uint32_t)index, value);
}

/* -- Fuse ------------------------------------------------------------------------------------------------ */

static PyObject *fuse_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    PyObject *died;
    static char *names[] = {"died", NULL};
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O", names, &died))
        return NULL;
    Fuse *self = (Fuse *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    self->died = Py_NewRef(died);
    self->on_store = Py_NewRef(Py_None);
    self->deaths = PyTuple_New(0);
    self->burns_at = UINT64_MAX;
    return (PyObject *)self;
}

static int fuse_traverse(Fuse *self, visitproc visit, void *arg)
{
    Py_VISIT(self->died);
    Py_VISIT(self->deaths);
    Py_VISIT(self->on_store);
    return 0;
}

static int fuse_clear(Fuse *self)
{
    Py_CLEAR(self->died);
    Py_CLEAR(self->deaths);
    Py_CLEAR(self->on_store);
    return 0;
}

static void fuse_dealloc(Fuse *self)
{
    PyObject_GC_UnTrack(self);
    fuse_clear(self);
    Py_TYPE(self)->tp_free((PyObject *)self);
}

static PyObject *fuse_deaths(Fuse *self, void *unused)
{
    (void)unused;
    return Py_NewRef(self->deaths);
}

static int fuse_set_deaths(Fuse *self, PyObject *value, void *unused)
{
    (void)unused;
    PyObject *deaths = value == NULL ? PyTuple_New(0) : PySequence_Tuple(value);
    if (deaths == NULL)
        return -1;
    uint64_t burns_at = UINT64_MAX;
    if (PyTuple_GET_SIZE(deaths) != 0)
        burns_at = PyLong_AsUnsignedLongLong(PyTuple_GET_ITEM(deaths, 0));
    if (PyErr_Occurred()) {
        Py_DECREF(deaths);
        return -1;
    }
    Py_SETREF(self->deaths, deaths);
    self->burns_at = burns_at;
    return 0;
}

static PyMemberDef fuse_members[] = {
    {"stores", T_ULONGLONG, offsetof(Fuse, stores), 0, "Stores of this incarnation."},
    {"on_store", T_OBJECT, offsetof(Fuse, on_store), 0, "None, or told the number of each store before it."},
    {NULL},
};

static PyGetSetDef fuse_properties[] = {
    {"deaths", (getter)fuse_deaths, (setter)fuse_set_deaths, "For each incarnation: how many stores it lives to see.",
     NULL},
    {NULL},
};

static PyTypeObject fuse_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "native.Fuse",
    .tp_basicsize = sizeof(Fuse),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_doc = "Kills a process before the store with a given number, counted from its start.",
    .tp_new = fuse_new,
    .tp_traverse = (traverseproc)fuse_traverse,
    .tp_clear = (inquiry)fuse_clear,
    .tp_dealloc = (destructor)fuse_dealloc,
    .tp_members = fuse_members,
    .tp_getset = fuse_properties,
};

/* -- Words ----------------------------------------------------------------------------------------------- */

typedef struct {
    PyObject_HEAD
    struct region *region;
    Py_ssize_t holds; /* buffers of it in use */
    bool is_closed;
} Words;

static PyTypeObject words_type;

static Py_ssize_t pages_of(const struct region *region)
{
    return (region->count + PAGE_WORDS - 1) / PAGE_WORDS;
}

/* The bytes of a page, of which the last may be shorter. */
static size_t page_bytes(const struct region *region, Py_ssize_t page)
{
    Py_ssize_t left = region->count - page * PAGE_WORDS;
    return (size_t)(left < PAGE_WORDS ? left : PAGE_WORDS) * sizeof *region->stored;
}

static struct region *make_region(Py_ssize_t count)
{
    struct region *region = calloc(1, sizeof *region);
    if (region != NULL) {
        region->count = count;
        region->words = calloc((size_t)count, sizeof *region->words);
        region->stored = calloc((size_t)count, sizeof *region->stored);
        region->is_used = calloc((size_t)pages_of(region), sizeof *region->is_used);
    }
    if (region == NULL || region->words == NULL || region->stored == NULL || region->is_used == NULL)
        Py_FatalError("no memory for words");
    return region;
}

static struct region *take_region(Py_ssize_t count)
{
    struct region **link = &unused;
    while (*link != NULL && (*link)->count != count)
        link = &(*link)->next;
    struct region *region = *link;
    if (region == NULL)
        return make_region(count);
    *link = region->next;
    for (Py_ssize_t page = 0; page < pages_of(region); page++) {
        if (!region->is_used[page])
            continue;
        memset(region->words + page * PAGE_WORDS, 0, page_bytes(region, page));
        memset(region->stored + page * PAGE_WORDS, 0, page_bytes(region, page));
        region->is_used[page] = false;
    }
    return region;
}

static void leave_region(struct region *region)
{
    if (--region->users != 0)
        return;
    if (region->previous != NULL)
        region->previous->next = region->next;
    else
        regions = region->next;
    if (region->next != NULL)
        region->next->previous = region->previous;
    Py_CLEAR(region->fuse);
    Py_CLEAR(region->on_store);
    if (KEEPS_MEMORY && region->traces != 0) {
        region->next = unused;
        unused = region;
        return;
    }
    free(region->words);
    free(region->stored);
    free(region->is_used);
    free(region);
}

static Words *words_over(struct region *region)
{
    Words *self = PyObject_New(Words, &words_type);
    if (self == NULL)
        return NULL;
    region->users++;
    self->region = region;
    self->holds = 0;
    self->is_closed = false;
    return self;
}

static PyObject *words_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    Py_ssize_t count;
    static char *names[] = {"count", NULL};
    (void)type;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "n", names, &count))
        return NULL;
    struct region *region = take_region(count);
    region->number = next_number++;
    region->traces = traces;
    region->on_store = Py_NewRef(Py_None);
    region->previous = NULL;
    region->next = regions;
    if (regions != NULL)
        regions->previous = region;
    regions = region;
    Words *self = words_over(region);
    if (self == NULL) {
        region->users = 1;
        leave_region(region);
    }
    return (PyObject *)self;
}

static void words_dealloc(Words *self)
{
    leave_region(self->region);
    PyObject_Free(self);
}

static int check_open(Words *self)
{
    if (!self->is_closed)
        return 0;
    PyErr_SetString(PyExc_AssertionError, "the map was closed");
    return -1;
}

static Py_ssize_t words_length(Words *self)
{
    return check_open(self) != 0 ? -1 : self->region->count;
}

static int check_index(Words *self, Py_ssize_t index)
{
    if (check_open(self) != 0)
        return -1;
    if (index >= 0 && index < self->region->count)
        return 0;
    PyErr_SetString(PyExc_IndexError, "index out of bounds");
    return -1;
}

static PyObject *words_item(Words *self, Py_ssize_t index)
{
    if (check_index(self, index) != 0)
        return NULL;
    return PyLong_FromUnsignedLongLong(load(self->region->words + index));
}

static int words_assign_item(Words *self, Py_ssize_t index, PyObject *object)
{
    if (check_index(self, index) != 0)
        return -1;
    if (object == NULL) {
        PyErr_SetString(PyExc_TypeError, "a word cannot be deleted");
        return -1;
    }
    uint64_t value = PyLong_AsUnsignedLongLong(object);
    if (PyErr_Occurred())
        return -1;
    MAY_DIE(return -1);
    store(self->region->words + index, value);
    return 0;
}

static int words_getbuffer(Words *self, Py_buffer *view, int flags)
{
    if (check_open(self) != 0) {
        view->obj = NULL;
        return -1;
    }
    Py_ssize_t bytes = self->region->count * 8;
    if (PyBuffer_FillInfo(view, (PyObject *)self, self->region->words, bytes, 0, flags) != 0)
        return -1;
    self->holds++;
    return 0;
}

static void words_releasebuffer(Words *self, Py_buffer *view)
{
    (void)view;
    self->holds--;
}

static PyObject *words_map(Words *self, PyObject *unused)
{
    (void)unused;
    return check_open(self) != 0 ? NULL : (PyObject *)words_over(self->region);
}

static PyObject *words_close(Words *self, PyObject *unused)
{
    (void)unused;
    if (self->holds != 0) {
        PyErr_SetString(PyExc_BufferError, "cannot close: its memory is in use");
        return NULL;
    }
    self->is_closed = true;
    Py_RETURN_NONE;
}

static PyObject *words_watch(Words *self, PyObject *listener)
{
    Py_SETREF(self->region->on_store, Py_NewRef(listener));
    Py_RETURN_NONE;
}

static PyObject *words_fuse(Words *self, void *unused)
{
    (void)unused;
    return Py_NewRef(self->region->fuse == NULL ? Py_None : (PyObject *)self->region->fuse);
}

static int words_set_fuse(Words *self, PyObject *value, void *unused)
{
    (void)unused;
    if (value == NULL || (value != Py_None && !PyObject_TypeCheck(value, &fuse_type))) {
        PyErr_SetString(PyExc_TypeError, "fuse must be a Fuse or None");
        return -1;
    }
    Fuse *fuse = value == Py_None ? NULL : (Fuse *)Py_NewRef(value);
    Py_XSETREF(self->region->fuse, fuse);
    return 0;
}

static PyMethodDef words_methods[] = {
    {"map", (PyCFunction)words_map, METH_NOARGS, "Return the same words, as another process maps them."},
    {"close", (PyCFunction)words_close, METH_NOARGS, "Unmap them; BufferError while somebody holds them."},
    {"watch", (PyCFunction)words_watch, METH_O, "Tell index, old and new value of each store; None: nobody."},
    {NULL},
};

static PyMemberDef words_members[] = {
    {"holds", T_PYSSIZET, offsetof(Words, holds), READONLY, "How often its buffer is in use."},
    {NULL},
};

static PyGetSetDef words_properties[] = {
    {"fuse", (getter)words_fuse, (setter)words_set_fuse, "The fuse of the one process that stores here.", NULL},
    {NULL},
};

static PySequenceMethods words_sequence = {
    .sq_length = (lenfunc)words_length,
    .sq_item = (ssizeargfunc)words_item,
    .sq_ass_item = (ssizeobjargproc)words_assign_item,
};

static PyBufferProcs words_buffer = {(getbufferproc)words_getbuffer, (releasebufferproc)words_releasebuffer};

static PyTypeObject words_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "native.Words",
    .tp_basicsize = sizeof(Words),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_doc = "Words of shared memory, zeros at first.",
    .tp_new = words_new,
    .tp_dealloc = (destructor)words_dealloc,
    .tp_as_sequence = &words_sequence,
    .tp_as_buffer = &words_buffer,
    .tp_methods = words_methods,
    .tp_members = words_members,
    .tp_getset = words_properties,
};

/* -- the trace ------------------------------------------------------------------------------------------- */

static PyObject *begin_trace(PyObject *module, PyObject *unused)
{
    (void)module, (void)unused;
    trace.count = 0;
    trace.is_on = true;
    next_number = 0;
    traces++;
    Py_RETURN_NONE;
}

static PyObject *end_trace(PyObject *module, PyObject *unused)
{
    (void)module, (void)unused;
    trace.is_on = false;
    return PyBytes_FromStringAndSize((char *)trace.entries, (Py_ssize_t)(trace.count * sizeof(struct entry)));
}

static PyObject *note_wake(PyObject *module, PyObject *who)
{
    (void)module;
    uint64_t value = PyLong_AsUnsignedLongLong(who);
    if (PyErr_Occurred())
        return NULL;
    note(WAKE, 0, value);
    /* Of wakes that follow each other, the order does not matter. */
    for (size_t at = trace.count; at > 1; at--) {
        struct entry *last = trace.entries + at - 1, *before = last - 1;
        if (before->words != WAKE || before->value <= last->value)
            break;
        struct entry kept = *last;
        *last = *before;
        *before = kept;
    }
    Py_RETURN_NONE;
}

static PyObject *hide_values(PyObject *module, PyObject *args)
{
    (void)module;
    if (!PyArg_ParseTuple(args, "II", &hidden_words, &hidden_index))
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *unguarded_stores(PyObject *module, PyObject *unused)
{
    (void)module, (void)unused;
    return PyLong_FromUnsignedLongLong(unguarded);
}

/* Return the first word that differs from what was stored, of the used pages or of all; -1 if none does. */
static Py_ssize_t stray_word(struct region *region, bool of_used_pages)
{
    for (Py_ssize_t page = 0; page < pages_of(region); page++) {
        Py_ssize_t index = page * PAGE_WORDS;
        if ((of_used_pages && !region->is_used[page]) ||
            memcmp(region->words + index, region->stored + index, page_bytes(region, page)) == 0)
            continue;
        while (load(region->words + index) == region->stored[index])
            index++;
        region->is_used[page] = true; /* it must be cleared before it is used again */
        return index;
    }
    return -1;
}

static PyObject *stray_words(PyObject *module, PyObject *args)
{
    int of_used_pages = 0;
    Py_ssize_t index;
    (void)module;
    if (!PyArg_ParseTuple(args, "|p", &of_used_pages))
        return NULL;
    for (struct region *region = regions; region != NULL; region = region->next)
        if (region->traces == traces && (index = stray_word(region, of_used_pages)) >= 0)
            return Py_BuildValue("[(In)]", (unsigned int)region->number, index);
    for (struct region *region = unused; region != NULL && !of_used_pages; region = region->next)
        if ((index = stray_word(region, false)) >= 0) {
            memcpy(region->words + index, region->stored + index, sizeof *region->stored); /* it is told once */
            return Py_BuildValue("[(In)]", (unsigned int)region->number, index);
        }
    return PyList_New(0);
}

/* The clock of the test build: each look turns it by a prime number of ns. */
static uint64_t clock_ns;

uint64_t monotonic_ns(void)
{
    return clock_ns += 1000003;
}

static PyObject *tick(PyObject *module, PyObject *unused)
{
    (void)module, (void)unused;
    return PyLong_FromUnsignedLongLong(monotonic_ns());
}

static PyObject *set_clock(PyObject *module, PyObject *ns)
{
    (void)module;
    clock_ns = PyLong_AsUnsignedLongLong(ns);
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static PyMethodDef functions[] = {
    {"tick", tick, METH_NOARGS, "Look at the clock of C, which goes on with each look."},
    {"set_clock", set_clock, METH_O, "Set the clock of C."},
    {"begin_trace", begin_trace, METH_NOARGS, "Write down all stores from now on; words are numbered from 0."},
    {"end_trace", end_trace, METH_NOARGS, "Return the stores: words, index (4 bytes each) and value (8)."},
    {"hide_values", hide_values, METH_VARARGS, "Write down no values of this word of these words."},
    {"note_wake", note_wake, METH_O, "Write down that somebody was woken."},
    {"stray_words", stray_words, METH_VARARGS,
     "Return the first word, of those made since the trace began, or used before, that was stored beside `store`;\n"
     "with True, look only at the pages where anything was stored as it should, which is faster: in the others, the\n"
     "word is found when they are looked at."},
    {"unguarded_stores", unguarded_stores, METH_NOARGS, "Count the stores of C that no MAY_DIE covered."},
    {NULL},
};

int add_fuse_types(PyObject *module)
{
    if (PyModule_AddType(module, &fuse_type) != 0 || PyModule_AddType(module, &words_type) != 0)
        return -1;
    return PyModule_AddFunctions(module, functions);
}
