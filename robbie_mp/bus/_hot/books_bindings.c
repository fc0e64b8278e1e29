/* The books of the core as Python types, on which the Python of robbie_mp/bus/core works.
 *
 * Slot, Link, Subscription and Channel are bases of the Python classes of these names: they only change where
 * the attributes lie that C needs. The containers have as much of the interface of dict and list as the core
 * uses. */
#include "books_bindings.h"
#include "ring_bindings.h"
#include "wakeup_bindings.h"
#include <errno.h>
#include <structmember.h>
#include <time.h>

/* -- helpers ------------------------------------------------------------------------------------------------ */

static bool read_number(PyObject *object, uint64_t *number)
{
    *number = PyLong_AsUnsignedLongLong(object);
    return !PyErr_Occurred();
}

/* Put an object of a type in the place of another one; false with an exception if it is of another type. */
static bool replace(PyObject **place, PyObject *object, PyTypeObject *type)
{
    if (object == NULL || !PyObject_TypeCheck(object, type)) {
        PyErr_Format(PyExc_TypeError, "must be %s", type->tp_name);
        return false;
    }
    Py_XSETREF(*place, Py_NewRef(object));
    return true;
}

static PyObject *or_none(PyObject *object)
{
    return Py_NewRef(object == NULL ? Py_None : object);
}

static void release_numbers(struct held_numbers *held)
{
    if (held->object == NULL)
        return;
    PyBuffer_Release(&held->buffer);
    Py_CLEAR(held->object);
}

/* Hold a buffer of 8-byte numbers; NULL with an exception if the object has none. */
static uint64_t *hold_numbers(struct held_numbers *held, PyObject *object)
{
    Py_buffer buffer;
    if (object == NULL) {
        PyErr_SetString(PyExc_TypeError, "cannot be deleted");
        return NULL;
    }
    if (PyObject_GetBuffer(object, &buffer, PyBUF_WRITABLE) != 0)
        return NULL;
    if ((uintptr_t)buffer.buf % sizeof(uint64_t) != 0 || buffer.len % (Py_ssize_t)sizeof(uint64_t) != 0) {
        PyBuffer_Release(&buffer);
        PyErr_SetString(PyExc_ValueError, "numbers must have 8 bytes each");
        return NULL;
    }
    release_numbers(held);
    held->object = Py_NewRef(object);
    held->buffer = buffer;
    return buffer.buf;
}

/* -- FreeRows: a stack of row numbers -------------------------------------------------------------------------- */

static int rows_init(PyObject *self, PyObject *args, PyObject *named)
{
    struct free_rows *rows = &((struct rows_object *)self)->rows;
    static char *names[] = {"count", NULL};
    unsigned long long count;
    if (!PyArg_ParseTupleAndKeywords(args, named, "K", names, &count))
        return -1;
    if (rows->rows != NULL || count >= NO_REFERENCE) {
        PyErr_SetString(PyExc_ValueError, "rows are made once, and fewer than 2^32 - 1");
        return -1;
    }
    rows->rows = PyMem_New(uint32_t, count + 1);
    if (rows->rows == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    rows->count = rows->capacity = count;
    for (uint64_t index = 0; index < count; index++)
        rows->rows[index] = (uint32_t)(count - 1 - index);
    return 0;
}

static void rows_free(PyObject *self)
{
    PyMem_Free(((struct rows_object *)self)->rows.rows);
    Py_TYPE(self)->tp_free(self);
}

static Py_ssize_t rows_length(PyObject *self)
{
    return (Py_ssize_t)((struct rows_object *)self)->rows.count;
}

static PyObject *rows_item(PyObject *self, Py_ssize_t index)
{
    struct free_rows *rows = &((struct rows_object *)self)->rows;
    if (index < 0 || (uint64_t)index >= rows->count) {
        PyErr_SetString(PyExc_IndexError, "no such row");
        return NULL;
    }
    return PyLong_FromUnsignedLong(rows->rows[index]);
}

static PyObject *rows_pop(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct free_rows *rows = &((struct rows_object *)self)->rows;
    if (rows->count == 0) {
        PyErr_SetString(PyExc_IndexError, "no row is free");
        return NULL;
    }
    return PyLong_FromUnsignedLong(rows->rows[--rows->count]);
}

static PyObject *rows_append(PyObject *self, PyObject *row)
{
    struct free_rows *rows = &((struct rows_object *)self)->rows;
    uint64_t number;
    if (!read_number(row, &number))
        return NULL;
    if (number >= rows->capacity || rows->count >= rows->capacity) {
        PyErr_SetString(PyExc_IndexError, "there is no such row, or it is free already");
        return NULL;
    }
    rows->rows[rows->count++] = (uint32_t)number;
    Py_RETURN_NONE;
}

static PyObject *rows_clear(PyObject *self, PyObject *Py_UNUSED(none))
{
    ((struct rows_object *)self)->rows.count = 0;
    Py_RETURN_NONE;
}

static PySequenceMethods rows_sequence = {.sq_length = rows_length, .sq_item = rows_item};

static PyMethodDef rows_methods[] = {
    {"pop", rows_pop, METH_NOARGS, "Take the row that was freed last."},
    {"append", rows_append, METH_O, "Free a row."},
    {"clear", rows_clear, METH_NOARGS, "Let no row be free."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject free_rows_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.FreeRows",
    .tp_doc = "Free rows of a table; the last one is taken next.",
    .tp_basicsize = sizeof(struct rows_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_init = rows_init,
    .tp_dealloc = rows_free,
    .tp_as_sequence = &rows_sequence,
    .tp_methods = rows_methods,
};

/* -- References: an ordered dict from references to numbers ---------------------------------------------------- */

static struct reference_list *list_of(PyObject *self)
{
    return &((struct references_object *)self)->list;
}

static int references_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((struct references_object *)self)->books);
    return 0;
}

static int references_clear_object(PyObject *self)
{
    struct references_object *references = (struct references_object *)self;
    if (references->books != NULL) {
        list_forget(&references->list); /* a dead core may have left it half changed */
        list_init(&references->list, NULL, 0);
        Py_CLEAR(references->books);
    }
    return 0;
}

static void references_free(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    references_clear_object(self);
    Py_TYPE(self)->tp_free(self);
}

/* Read a key; false with an exception if there is no such reference at all. */
static bool read_key(PyObject *self, PyObject *key, uint32_t *reference)
{
    uint64_t number;
    if (!read_number(key, &number))
        return false;
    if (number >= list_of(self)->references) {
        PyErr_SetObject(PyExc_KeyError, key);
        return false;
    }
    *reference = (uint32_t)number;
    return true;
}

/* Read a key that is in the list; false with an exception if it is not. */
static bool read_known(PyObject *self, PyObject *key, uint32_t *reference)
{
    if (!read_key(self, key, reference))
        return false;
    if (list_has(list_of(self), *reference))
        return true;
    PyErr_SetObject(PyExc_KeyError, key);
    return false;
}

static Py_ssize_t references_length(PyObject *self)
{
    return (Py_ssize_t)list_of(self)->count;
}

static int references_contains(PyObject *self, PyObject *key)
{
    uint64_t number;
    return read_number(key, &number) ? list_has(list_of(self), number) : -1;
}

static PyObject *references_get(PyObject *self, PyObject *key)
{
    uint32_t reference;
    if (!read_known(self, key, &reference))
        return NULL;
    return PyLong_FromUnsignedLongLong(list_of(self)->places[reference].value);
}

static int references_set(PyObject *self, PyObject *key, PyObject *value)
{
    struct reference_list *list = list_of(self);
    uint32_t reference;
    uint64_t number;
    if (value == NULL) {
        if (!read_known(self, key, &reference))
            return -1;
        list_remove(list, reference);
        return 0;
    }
    if (!read_key(self, key, &reference) || !read_number(value, &number))
        return -1;
    if (list_has(list, reference))
        list->places[reference].value = number; /* it keeps its place */
    else
        list_append(list, reference, number);
    return 0;
}

static PyObject *references_pop(PyObject *self, PyObject *key)
{
    uint32_t reference;
    if (!read_known(self, key, &reference))
        return NULL;
    return PyLong_FromUnsignedLongLong(list_remove(list_of(self), reference));
}

static PyObject *references_clear(PyObject *self, PyObject *Py_UNUSED(none))
{
    list_clear(list_of(self));
    Py_RETURN_NONE;
}

static PyObject *references_move_to_end(PyObject *self, PyObject *args, PyObject *named)
{
    static char *names[] = {"key", "last", NULL};
    PyObject *key;
    int last = 1;
    uint32_t reference;
    if (!PyArg_ParseTupleAndKeywords(args, named, "O|p", names, &key, &last) || !read_known(self, key, &reference))
        return NULL;
    struct reference_list *list = list_of(self);
    if (last)
        list_append(list, reference, list->places[reference].value);
    else
        list_move_to_front(list, reference);
    Py_RETURN_NONE;
}

/* A list of what `make` makes of each reference, in order. */
static PyObject *list_all(PyObject *self, PyObject *(*make)(uint32_t reference, uint64_t value))
{
    const struct reference_list *list = list_of(self);
    PyObject *result = PyList_New(0);
    for (uint32_t at = list->first; result != NULL && at != NO_REFERENCE; at = list->places[at].after) {
        PyObject *item = make(at, list->places[at].value);
        if (item == NULL || PyList_Append(result, item) != 0)
            Py_CLEAR(result);
        Py_XDECREF(item);
    }
    return result;
}

static PyObject *make_item(uint32_t reference, uint64_t value)
{
    return Py_BuildValue("(kK)", (unsigned long)reference, (unsigned long long)value);
}

static PyObject *make_key(uint32_t reference, uint64_t Py_UNUSED(value))
{
    return PyLong_FromUnsignedLong(reference);
}

static PyObject *make_value(uint32_t Py_UNUSED(reference), uint64_t value)
{
    return PyLong_FromUnsignedLongLong(value);
}

static PyObject *references_items(PyObject *self, PyObject *Py_UNUSED(none))
{
    return list_all(self, make_item);
}

static PyObject *references_values(PyObject *self, PyObject *Py_UNUSED(none))
{
    return list_all(self, make_value);
}

static PyObject *references_keys(PyObject *self, PyObject *Py_UNUSED(none))
{
    return list_all(self, make_key);
}

struct references_iterator {
    PyObject_HEAD
    PyObject *references;
    uint32_t next;
};

static void iterator_free(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    Py_CLEAR(((struct references_iterator *)self)->references);
    Py_TYPE(self)->tp_free(self);
}

static int iterator_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((struct references_iterator *)self)->references);
    return 0;
}

static PyObject *iterator_next(PyObject *self)
{
    struct references_iterator *iterator = (struct references_iterator *)self;
    uint32_t at = iterator->next;
    if (at == NO_REFERENCE)
        return NULL;
    const struct reference_list *list = list_of(iterator->references);
    if (!list_has(list, at)) {
        PyErr_SetString(PyExc_RuntimeError, "the references changed during the iteration");
        return NULL;
    }
    iterator->next = list->places[at].after;
    return PyLong_FromUnsignedLong(at);
}

static PyTypeObject iterator_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.ReferencesIterator",
    .tp_basicsize = sizeof(struct references_iterator),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .tp_dealloc = iterator_free,
    .tp_traverse = iterator_traverse,
    .tp_iter = PyObject_SelfIter,
    .tp_iternext = iterator_next,
};

static PyObject *references_iterate(PyObject *self)
{
    struct references_iterator *iterator =
        (struct references_iterator *)iterator_type.tp_alloc(&iterator_type, 0);
    if (iterator == NULL)
        return NULL;
    iterator->references = Py_NewRef(self);
    iterator->next = list_of(self)->first;
    return (PyObject *)iterator;
}

static PyMappingMethods references_mapping = {
    .mp_length = references_length, .mp_subscript = references_get, .mp_ass_subscript = references_set};
static PySequenceMethods references_sequence = {.sq_contains = references_contains};

static PyMethodDef references_methods[] = {
    {"pop", references_pop, METH_O, "Take a reference out; return its number."},
    {"clear", references_clear, METH_NOARGS, "Take all out."},
    {"items", references_items, METH_NOARGS, "List the references, each with its number."},
    {"values", references_values, METH_NOARGS, "List the numbers."},
    {"keys", references_keys, METH_NOARGS, "List the references."},
    {"move_to_end", (PyCFunction)(void (*)(void))references_move_to_end, METH_VARARGS | METH_KEYWORDS,
     "Move a reference to the end, or to the front."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject references_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.References",
    .tp_doc = "References in order, each with a number; made by Books.references().",
    .tp_basicsize = sizeof(struct references_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .tp_dealloc = references_free,
    .tp_traverse = references_traverse,
    .tp_clear = references_clear_object,
    .tp_as_mapping = &references_mapping,
    .tp_as_sequence = &references_sequence,
    .tp_iter = references_iterate,
    .tp_methods = references_methods,
};

/* Put a list of references in the place of another one. */
static int set_references(PyObject **place, struct reference_list **list, PyObject *value)
{
    if (!replace(place, value, &references_type))
        return -1;
    *list = list_of(value);
    return 0;
}

/* -- Subscription ---------------------------------------------------------------------------------------------- */

static PyObject *get_queued(PyObject *self, void *Py_UNUSED(closure))
{
    uint32_t queued = ((struct subscription_object *)self)->subscription.queued;
    if (queued == NO_REFERENCE)
        Py_RETURN_NONE;
    return PyLong_FromUnsignedLong(queued);
}

static int set_queued(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    uint64_t queued = NO_REFERENCE;
    if (value == NULL || (value != Py_None && !read_number(value, &queued)) || queued > NO_REFERENCE) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_ValueError, "must be a reference or None");
        return -1;
    }
    ((struct subscription_object *)self)->subscription.queued = (uint32_t)queued;
    return 0;
}

static PyMemberDef subscription_members[] = {
    {"index", T_ULONGLONG, offsetof(struct subscription_object, subscription.index), 0, NULL},
    {"at", T_ULONGLONG, offsetof(struct subscription_object, subscription.at), 0, NULL},
    {"slot", T_ULONGLONG, offsetof(struct subscription_object, subscription.slot), 0, NULL},
    {"declaration", T_ULONGLONG, offsetof(struct subscription_object, subscription.declaration), 0, NULL},
    {"newest_only", T_BOOL, offsetof(struct subscription_object, subscription.newest_only), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef subscription_attributes[] = {
    {"queued", get_queued, set_queued, NULL, NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static void subscription_free(PyObject *self)
{
    Py_TYPE(self)->tp_free(self);
}

PyTypeObject subscription_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Subscription",
    .tp_doc = "Where the attributes of a Subscription of directory.py lie.",
    .tp_basicsize = sizeof(struct subscription_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE,
    .tp_new = PyType_GenericNew,
    .tp_dealloc = subscription_free,
    .tp_members = subscription_members,
    .tp_getset = subscription_attributes,
};

/* -- Channel --------------------------------------------------------------------------------------------------- */

static PyObject *get_subscriptions(PyObject *self, void *Py_UNUSED(closure))
{
    return or_none(((struct channel_object *)self)->subscriptions);
}

static int set_subscriptions(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct channel_object *channel = (struct channel_object *)self;
    if (value == NULL || !PyTuple_Check(value)) {
        PyErr_SetString(PyExc_TypeError, "must be a tuple of subscriptions");
        return -1;
    }
    Py_ssize_t count = PyTuple_GET_SIZE(value);
    struct subscription **subscriptions = PyMem_New(struct subscription *, (size_t)count + 1);
    if (subscriptions == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    for (Py_ssize_t index = 0; index < count; index++) {
        PyObject *item = PyTuple_GET_ITEM(value, index);
        if (!PyObject_TypeCheck(item, &subscription_type)) {
            PyMem_Free(subscriptions);
            PyErr_SetString(PyExc_TypeError, "must be a tuple of subscriptions");
            return -1;
        }
        subscriptions[index] = &((struct subscription_object *)item)->subscription;
    }
    PyMem_Free(channel->channel.subscriptions);
    channel->channel.subscriptions = subscriptions;
    channel->channel.subscription_count = (uint64_t)count;
    Py_XSETREF(channel->subscriptions, Py_NewRef(value));
    return 0;
}

static int channel_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((struct channel_object *)self)->subscriptions);
    return 0;
}

static int channel_clear(PyObject *self)
{
    struct channel_object *channel = (struct channel_object *)self;
    channel->channel.subscription_count = 0;
    PyMem_Free(channel->channel.subscriptions);
    channel->channel.subscriptions = NULL;
    Py_CLEAR(channel->subscriptions);
    return 0;
}

static void channel_free(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    channel_clear(self);
    Py_TYPE(self)->tp_free(self);
}

static PyMemberDef channel_members[] = {
    {"index", T_ULONGLONG, offsetof(struct channel_object, channel.index), 0, NULL},
    {"at", T_ULONGLONG, offsetof(struct channel_object, channel.at), 0, NULL},
    {"paced_sequence", T_ULONGLONG, offsetof(struct channel_object, channel.paced_sequence), 0, NULL},
    {"paced_reference", T_UINT, offsetof(struct channel_object, channel.paced_reference), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef channel_attributes[] = {
    {"subscriptions", get_subscriptions, set_subscriptions, NULL, NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

PyTypeObject channel_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Channel",
    .tp_doc = "Where the attributes of a Channel of directory.py lie.",
    .tp_basicsize = sizeof(struct channel_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC,
    .tp_new = PyType_GenericNew,
    .tp_dealloc = channel_free,
    .tp_traverse = channel_traverse,
    .tp_clear = channel_clear,
    .tp_members = channel_members,
    .tp_getset = channel_attributes,
};

/* -- Link ------------------------------------------------------------------------------------------------------ */

static PyObject *get_object(PyObject *self, void *offset)
{
    return or_none(*(PyObject **)((char *)self + (size_t)offset));
}

static int set_outbound(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    if (!replace(&link->outbound, value, &ring_reader_type))
        return -1;
    link->link.outbound = &((struct ring_reader_object *)value)->ring;
    return 0;
}

static int set_inbound(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    if (!replace(&link->inbound, value, &ring_writer_type))
        return -1;
    link->link.inbound = &((struct ring_writer_object *)value)->ring;
    return 0;
}

static int set_freed(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    if (!replace(&link->freed, value, &number_ring_writer_type))
        return -1;
    link->link.freed = &((struct ring_writer_object *)value)->ring;
    return 0;
}

static int set_pushed(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    return set_references(&link->pushed, &link->link.pushed, value);
}

static int set_pinned(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    return set_references(&link->pinned, &link->link.pinned, value);
}

static int set_in_flight(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    uint64_t *numbers = hold_numbers(&link->in_flight, value);
    if (numbers == NULL)
        return -1;
    link->link.in_flight = numbers;
    return 0;
}

static int set_windows(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    uint64_t *numbers = hold_numbers(&link->windows, value);
    if (numbers == NULL)
        return -1;
    link->link.windows = numbers;
    return 0;
}

static int set_wake(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    if (!replace(&link->wake, value, &PyBaseObject_Type))
        return -1;
    link->wakeup = wakeup_of(value);
    return 0;
}

static int set_channels(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct link_object *link = (struct link_object *)self;
    struct channel *channels[DECLARATION_COUNT] = {NULL};
    PyObject *key, *channel;
    Py_ssize_t at = 0;
    if (value == NULL || !PyDict_Check(value)) {
        PyErr_SetString(PyExc_TypeError, "must be a dict of channels");
        return -1;
    }
    while (PyDict_Next(value, &at, &key, &channel)) {
        uint64_t number;
        if (!read_number(key, &number))
            return -1;
        if (number >= DECLARATION_COUNT || !PyObject_TypeCheck(channel, &channel_type)) {
            PyErr_SetString(PyExc_ValueError, "must be a dict of channels by declaration");
            return -1;
        }
        channels[number] = &((struct channel_object *)channel)->channel;
    }
    memcpy(link->link.channels, channels, sizeof channels);
    Py_XSETREF(link->channels, Py_NewRef(value));
    return 0;
}

static int link_traverse(PyObject *self, visitproc visit, void *arg)
{
    struct link_object *link = (struct link_object *)self;
    Py_VISIT(link->channels);
    Py_VISIT(link->pushed);
    Py_VISIT(link->pinned);
    Py_VISIT(link->wake);
    return 0;
}

static int link_clear(PyObject *self)
{
    struct link_object *link = (struct link_object *)self;
    link->link.has_ended = true;
    link->link.ready = false;
    memset(link->link.channels, 0, sizeof link->link.channels);
    link->link.pushed = link->link.pinned = NULL;
    link->wakeup = NULL;
    Py_CLEAR(link->channels);
    Py_CLEAR(link->pushed);
    Py_CLEAR(link->pinned);
    Py_CLEAR(link->wake);
    return 0;
}

static void link_free(PyObject *self)
{
    struct link_object *link = (struct link_object *)self;
    PyObject_GC_UnTrack(self);
    link_clear(self);
    Py_CLEAR(link->outbound);
    Py_CLEAR(link->inbound);
    Py_CLEAR(link->freed);
    release_numbers(&link->in_flight);
    release_numbers(&link->windows);
    Py_TYPE(self)->tp_free(self);
}

/* Whether a link has all that C needs, for a run of this number of slots. */
static bool is_whole(const struct link_object *link, uint64_t slots)
{
    return link->outbound != NULL && link->link.outbound->place.records != NULL && link->inbound != NULL &&
           link->link.inbound->place.records != NULL && link->freed != NULL &&
           link->link.freed->place.records != NULL && link->link.pushed != NULL && link->link.pinned != NULL &&
           link->wake != NULL && link->in_flight.object != NULL && link->windows.object != NULL &&
           (uint64_t)link->in_flight.buffer.len >= slots * sizeof(uint64_t) &&
           (uint64_t)link->windows.buffer.len >= slots * sizeof(uint64_t);
}

static PyMemberDef link_members[] = {
    {"slot", T_ULONGLONG, offsetof(struct link_object, link.slot), 0, NULL},
    {"source", T_ULONGLONG, offsetof(struct link_object, link.source), 0, NULL},
    {"credit", T_ULONGLONG, offsetof(struct link_object, link.credit), 0, NULL},
    {"awaited_freed", T_ULONGLONG, offsetof(struct link_object, link.awaited_freed), 0, NULL},
    {"wanted_release", T_ULONGLONG, offsetof(struct link_object, link.wanted_release), 0, NULL},
    {"ready", T_BOOL, offsetof(struct link_object, link.ready), 0, NULL},
    {"has_ended", T_BOOL, offsetof(struct link_object, link.has_ended), 0, NULL},
    {"paces", T_BOOL, offsetof(struct link_object, link.paces), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef link_attributes[] = {
    {"outbound", get_object, set_outbound, NULL, (void *)offsetof(struct link_object, outbound)},
    {"inbound", get_object, set_inbound, NULL, (void *)offsetof(struct link_object, inbound)},
    {"freed", get_object, set_freed, NULL, (void *)offsetof(struct link_object, freed)},
    {"pushed", get_object, set_pushed, NULL, (void *)offsetof(struct link_object, pushed)},
    {"pinned", get_object, set_pinned, NULL, (void *)offsetof(struct link_object, pinned)},
    {"in_flight", get_object, set_in_flight, NULL, (void *)offsetof(struct link_object, in_flight.object)},
    {"windows", get_object, set_windows, NULL, (void *)offsetof(struct link_object, windows.object)},
    {"channels", get_object, set_channels, NULL, (void *)offsetof(struct link_object, channels)},
    {"wake", get_object, set_wake, NULL, (void *)offsetof(struct link_object, wake)},
    {NULL, NULL, NULL, NULL, NULL},
};

PyTypeObject link_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Link",
    .tp_doc = "Where the attributes of a Link of members.py lie.",
    .tp_basicsize = sizeof(struct link_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC,
    .tp_new = PyType_GenericNew,
    .tp_dealloc = link_free,
    .tp_traverse = link_traverse,
    .tp_clear = link_clear,
    .tp_members = link_members,
    .tp_getset = link_attributes,
};

/* -- Slot ------------------------------------------------------------------------------------------------------ */

static int set_waiting(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct slot_object *slot = (struct slot_object *)self;
    return set_references(&slot->waiting, &slot->slot.waiting, value);
}

static int set_link(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    struct slot_object *slot = (struct slot_object *)self;
    if (value == Py_None) {
        slot->slot.link = NULL;
        Py_CLEAR(slot->link);
        return 0;
    }
    struct link_object *link = (struct link_object *)value;
    if (value == NULL || !PyObject_TypeCheck(value, &link_type) || link->link.slot != slot->slot.index ||
        !is_whole(link, slot->slot.index + 1)) {
        PyErr_SetString(PyExc_ValueError, "must be a whole link of this slot, or None");
        return -1;
    }
    slot->slot.link = &link->link;
    Py_XSETREF(slot->link, Py_NewRef(value));
    return 0;
}

static int slot_traverse(PyObject *self, visitproc visit, void *arg)
{
    struct slot_object *slot = (struct slot_object *)self;
    Py_VISIT(slot->waiting);
    Py_VISIT(slot->link);
    return 0;
}

static int slot_clear(PyObject *self)
{
    struct slot_object *slot = (struct slot_object *)self;
    slot->slot.link = NULL;
    slot->slot.waiting = NULL;
    Py_CLEAR(slot->waiting);
    Py_CLEAR(slot->link);
    return 0;
}

static void slot_free(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    slot_clear(self);
    Py_TYPE(self)->tp_free(self);
}

static PyMemberDef slot_members[] = {
    {"index", T_ULONGLONG, offsetof(struct slot_object, slot.index), 0, NULL},
    {"at", T_ULONGLONG, offsetof(struct slot_object, slot.at), 0, NULL},
    {"queue_messages", T_ULONGLONG, offsetof(struct slot_object, slot.queue_messages), 0, NULL},
    {"queue_bytes", T_ULONGLONG, offsetof(struct slot_object, slot.queue_bytes), 0, NULL},
    {"yields", T_BOOL, offsetof(struct slot_object, slot.yields), 0, NULL},
    {"waiting_bytes", T_ULONGLONG, offsetof(struct slot_object, slot.waiting_bytes), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef slot_attributes[] = {
    {"waiting", get_object, set_waiting, NULL, (void *)offsetof(struct slot_object, waiting)},
    {"link", get_object, set_link, NULL, (void *)offsetof(struct slot_object, link)},
    {NULL, NULL, NULL, NULL, NULL},
};

PyTypeObject slot_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Slot",
    .tp_doc = "Where the attributes of a Slot of members.py lie.",
    .tp_basicsize = sizeof(struct slot_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC,
    .tp_new = PyType_GenericNew,
    .tp_dealloc = slot_free,
    .tp_traverse = slot_traverse,
    .tp_clear = slot_clear,
    .tp_members = slot_members,
    .tp_getset = slot_attributes,
};

/* -- Books ----------------------------------------------------------------------------------------------------- */

static struct books_object *books_of(PyObject *self)
{
    return (struct books_object *)self;
}

static void wake(void *Py_UNUSED(context), struct link *link)
{
    if (PyErr_Occurred())
        return;
    struct link_object *object = (struct link_object *)((char *)link - offsetof(struct link_object, link));
    if (object->wakeup != NULL) {
        wakeup_post(object->wakeup);
        return;
    }
    PyObject *callable = Py_NewRef(object->wake);
    Py_XDECREF(PyObject_CallNoArgs(callable));
    Py_DECREF(callable);
}

static bool fits(uint64_t at, uint64_t count, uint64_t row_words, const struct held_words *words)
{
    return at <= (uint64_t)words->count && count <= ((uint64_t)words->count - at) / row_words;
}

static bool allocate(struct books_object *object)
{
    struct books *books = &object->books;
    books->places = PyMem_Calloc(books->reference_count + 1, sizeof *books->places);
    books->subscriptions = PyMem_Calloc(books->subscription_count + 1, sizeof(struct subscription *));
    object->subscriptions = PyMem_Calloc(books->subscription_count + 1, sizeof(PyObject *));
    object->router.claims = PyMem_Calloc(books->subscription_count + 1, sizeof(uint32_t));
    return books->places != NULL && books->subscriptions != NULL &&
           object->subscriptions != NULL && object->router.claims != NULL;
}

static int books_init(PyObject *self, PyObject *args, PyObject *named)
{
    struct books_object *object = books_of(self);
    struct books *books = &object->books;
    static char *names[] = {"words",        "handles_at",      "references_at", "subscriptions",
                            "free_handles", "free_references", "holders",       "message_bytes", NULL};
    PyObject *words, *free_handles, *free_references, *holders;
    unsigned long long handles_at, references_at, subscriptions, message_bytes;
    if (!PyArg_ParseTupleAndKeywords(args, named, "OKKKO!O!OK", names, &words, &handles_at, &references_at,
                                     &subscriptions, &free_rows_type, &free_handles,
                                     &free_rows_type, &free_references, &holders, &message_bytes))
        return -1;
    if (object->words.words != NULL) {
        PyErr_SetString(PyExc_TypeError, "books are made only once");
        return -1;
    }
    if (hold_words(&object->words, words, true) != 0)
        return -1;
    books->words = object->words.words;
    books->holders = hold_numbers(&object->holders, holders);
    if (books->holders == NULL)
        return -1;
    object->free_handles = Py_NewRef(free_handles);
    object->free_references = Py_NewRef(free_references);
    books->free_handles = &((struct rows_object *)free_handles)->rows;
    books->free_references = &((struct rows_object *)free_references)->rows;
    books->handle_count = books->free_handles->capacity;
    books->reference_count = books->free_references->capacity;
    books->subscription_count = subscriptions;
    if (!fits(handles_at, books->handle_count, HANDLE_WORDS, &object->words) ||
        !fits(references_at, books->reference_count, REFERENCE_WORDS, &object->words) ||
        (uint64_t)object->holders.buffer.len < books->handle_count * sizeof(uint64_t)) {
        PyErr_SetString(PyExc_ValueError, "the tables do not fit into their memory");
        return -1;
    }
    books->handle_rows = books->words + handles_at;
    books->reference_rows = books->words + references_at;
    object->router.books = books;
    object->router.message_bytes = message_bytes;
    object->router.wake = wake;
    if (!allocate(object)) {
        PyErr_NoMemory();
        return -1;
    }
    return 0;
}

static int books_traverse(PyObject *self, visitproc visit, void *arg)
{
    struct books_object *object = books_of(self);
    Py_VISIT(object->slots);
    Py_VISIT(object->links);
    Py_VISIT(object->links_in_round);
    for (uint64_t index = 0; object->subscriptions != NULL && index < object->books.subscription_count; index++)
        Py_VISIT(object->subscriptions[index]);
    return 0;
}

static int books_clear(PyObject *self)
{
    struct books_object *object = books_of(self);
    object->books.outdated_first = NULL;
    object->books.to_post_first = NULL;
    for (uint64_t index = 0; object->subscriptions != NULL && index < object->books.subscription_count; index++) {
        object->books.subscriptions[index] = NULL;
        Py_CLEAR(object->subscriptions[index]);
    }
    object->books.slot_count = 0; /* from here on nothing is served */
    Py_CLEAR(object->slots);
    object->books.link_count = 0;
    Py_CLEAR(object->links);
    Py_CLEAR(object->links_in_round);
    return 0;
}

static void books_free(PyObject *self)
{
    struct books_object *object = books_of(self);
    PyObject_GC_UnTrack(self);
    books_clear(self);
    PyMem_Free(object->books.places);
    PyMem_Free(object->books.slots);
    PyMem_Free(object->books.subscriptions);
    PyMem_Free(object->subscriptions);
    PyMem_Free(object->router.claims);
    PyMem_Free(object->books.links);
    PyMem_Free(object->router.round.links);
    PyMem_Free(object->router.round.releasing);
    PyMem_Free(object->router.round.unfinished);
    Py_CLEAR(object->free_handles);
    Py_CLEAR(object->free_references);
    release_numbers(&object->holders);
    release_words(&object->words);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *books_set_slots(PyObject *self, PyObject *slots)
{
    struct books_object *object = books_of(self);
    struct books *books = &object->books;
    if (!PyTuple_Check(slots) || object->slots != NULL) {
        PyErr_SetString(PyExc_TypeError, "must be a tuple, and set once");
        return NULL;
    }
    Py_ssize_t count = PyTuple_GET_SIZE(slots);
    books->slots = PyMem_Calloc((size_t)count + 1, sizeof(struct slot *));
    if (books->slots == NULL)
        return PyErr_NoMemory();
    for (Py_ssize_t index = 0; index < count; index++) {
        PyObject *item = PyTuple_GET_ITEM(slots, index);
        struct slot *slot = &((struct slot_object *)item)->slot;
        if (!PyObject_TypeCheck(item, &slot_type) || slot->index != (uint64_t)index || slot->waiting == NULL ||
            !fits(slot->at, 1, PUBLISHER_WORDS, &object->words)) {
            PyMem_Free(books->slots);
            books->slots = NULL;
            PyErr_SetString(PyExc_ValueError, "must be the slots, in order");
            return NULL;
        }
        books->slots[index] = slot;
    }
    object->slots = Py_NewRef(slots);
    books->slot_count = (uint64_t)count;
    Py_RETURN_NONE;
}

static PyObject *books_references(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct references_object *references =
        (struct references_object *)references_type.tp_alloc(&references_type, 0);
    if (references == NULL)
        return NULL;
    list_init(&references->list, books_of(self)->books.places, books_of(self)->books.reference_count);
    references->books = Py_NewRef(self);
    return (PyObject *)references;
}

static PyObject *books_enter(PyObject *self, PyObject *value)
{
    struct books_object *object = books_of(self);
    struct books *books = &object->books;
    if (!PyObject_TypeCheck(value, &subscription_type)) {
        PyErr_SetString(PyExc_TypeError, "must be a subscription");
        return NULL;
    }
    struct subscription *subscription = &((struct subscription_object *)value)->subscription;
    uint64_t index = subscription->index;
    if (index >= books->subscription_count || subscription->slot >= books->slot_count ||
        !fits(subscription->at, 1, SUBSCRIPTION_WORDS, &object->words)) {
        PyErr_SetString(PyExc_ValueError, "must be a subscription in one of the rows");
        return NULL;
    }
    books->subscriptions[index] = subscription;
    Py_XSETREF(object->subscriptions[index], Py_NewRef(value));
    Py_RETURN_NONE;
}

static struct slot *known_slot(PyObject *self, PyObject *value)
{
    struct books *books = &books_of(self)->books;
    struct slot *slot = &((struct slot_object *)value)->slot;
    if (PyObject_TypeCheck(value, &slot_type) && slot->index < books->slot_count &&
        books->slots[slot->index] == slot && slot->waiting != NULL)
        return slot;
    PyErr_SetString(PyExc_ValueError, "must be one of the slots");
    return NULL;
}

static PyObject *books_outdate(PyObject *self, PyObject *value)
{
    struct slot *slot = known_slot(self, value);
    if (slot == NULL)
        return NULL;
    outdate(&books_of(self)->books, slot);
    Py_RETURN_NONE;
}

static PyObject *books_note_post(PyObject *self, PyObject *value)
{
    struct books *books = &books_of(self)->books;
    struct link *link = &((struct link_object *)value)->link;
    if (!PyObject_TypeCheck(value, &link_type) || link->slot >= books->slot_count ||
        books->slots[link->slot]->link != link) {
        PyErr_SetString(PyExc_ValueError, "must be the link of one of the slots");
        return NULL;
    }
    note_post(books, link);
    Py_RETURN_NONE;
}

static PyObject *books_post(PyObject *self, PyObject *Py_UNUSED(none))
{
    post(&books_of(self)->router);
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *books_write_figures(PyObject *self, PyObject *Py_UNUSED(none))
{
    MAY_DIE(return NULL);
    write_figures(&books_of(self)->books);
    Py_RETURN_NONE;
}

static PyObject *books_somebody_waits(PyObject *self, PyObject *Py_UNUSED(none))
{
    return PyBool_FromLong(somebody_waits(&books_of(self)->books));
}

static PyObject *books_before_sleep(PyObject *self, PyObject *Py_UNUSED(none))
{
    MAY_DIE(return NULL);
    return PyBool_FromLong(before_sleep(&books_of(self)->books));
}

static PyObject *books_serve(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    struct books_object *object = books_of(self);
    uint64_t records;
    if (count != 3 || !PyObject_TypeCheck(arguments[0], &link_type)) {
        PyErr_SetString(PyExc_TypeError, "expected a link, a number of records, and whether the time is special");
        return NULL;
    }
    struct link_object *link = (struct link_object *)arguments[0];
    int is_special = PyObject_IsTrue(arguments[2]);
    if (!read_number(arguments[1], &records) || is_special < 0)
        return NULL;
    if (link->link.slot >= object->books.slot_count || !is_whole(link, object->books.slot_count)) {
        PyErr_SetString(PyExc_ValueError, "must be a whole link");
        return NULL;
    }
    object->router.is_special = is_special;
    MAY_DIE(return NULL);
    uint64_t handled = serve(&object->router, &link->link, records);
    return PyErr_Occurred() ? NULL : PyLong_FromUnsignedLongLong(handled);
}

/* Make room in the arrays of links; false with an exception if there is no memory. */
static bool make_room(struct books_object *object, uint64_t count)
{
    struct link ***arrays[] = {&object->books.links, &object->router.round.links, &object->router.round.releasing,
                               &object->router.round.unfinished};
    if (count <= object->link_room)
        return true;
    for (size_t index = 0; index < sizeof arrays / sizeof *arrays; index++) {
        struct link **grown = PyMem_Realloc(*arrays[index], count * sizeof(struct link *));
        if (grown == NULL) {
            PyErr_NoMemory();
            return false;
        }
        *arrays[index] = grown;
    }
    object->link_room = count;
    return true;
}

static PyObject *books_set_links(PyObject *self, PyObject *links)
{
    struct books_object *object = books_of(self);
    struct books *books = &object->books;
    if (!PyTuple_Check(links) || object->links_in_round != NULL) {
        PyErr_SetString(PyExc_TypeError, "must be a tuple, and set between rounds");
        return NULL;
    }
    Py_ssize_t count = PyTuple_GET_SIZE(links);
    for (Py_ssize_t index = 0; index < count; index++) {
        PyObject *item = PyTuple_GET_ITEM(links, index);
        if (!PyObject_TypeCheck(item, &link_type) || ((struct link_object *)item)->link.slot >= books->slot_count ||
            !is_whole((struct link_object *)item, books->slot_count)) {
            PyErr_SetString(PyExc_ValueError, "must be whole links");
            return NULL;
        }
    }
    if (!make_room(object, (uint64_t)count))
        return NULL;
    for (Py_ssize_t index = 0; index < count; index++) {
        struct link *link = &((struct link_object *)PyTuple_GET_ITEM(links, index))->link;
        link->head_seen = link->outbound->tail;
        books->links[index] = link;
    }
    books->link_count = (uint64_t)count;
    Py_XSETREF(object->links, Py_NewRef(links));
    Py_RETURN_NONE;
}

/* Begin a round or go on with it; a link of which Python must handle a record, or NULL when it is over. */
static struct link *go_on(struct books_object *object, uint64_t records_per_turn)
{
    if (object->links_in_round == NULL) {
        begin_round(&object->router);
        object->links_in_round = Py_NewRef(object->links);
    }
    struct link *link = serve_round(&object->router, records_per_turn);
    if (link == NULL)
        Py_CLEAR(object->links_in_round);
    return link;
}

static PyObject *object_of(struct link *link)
{
    return link == NULL ? NULL : (PyObject *)((char *)link - offsetof(struct link_object, link));
}

static PyObject *books_serve_round(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    struct books_object *object = books_of(self);
    uint64_t records_per_turn;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "expected the records of a turn, and whether the time is special");
        return NULL;
    }
    int is_special = PyObject_IsTrue(arguments[1]);
    if (!read_number(arguments[0], &records_per_turn) || is_special < 0)
        return NULL;
    if (object->links == NULL)
        Py_RETURN_NONE;
    object->router.is_special = is_special;
    MAY_DIE(return NULL);
    struct link *link = go_on(object, records_per_turn);
    return PyErr_Occurred() ? NULL : or_none(object_of(link));
}

static uint64_t monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000 + (uint64_t)now.tv_nsec;
}

/* Wait for a post without the GIL; 0, or the error's number. */
static int sleep_as_core(struct books *books, struct wakeup *wakeup, uint64_t timeout_ns)
{
    shared_word *wakeups = books->words + CORE_WAKEUPS;
    store(wakeups, load(wakeups) + 1);
    const int error = sleep_until_post(wakeup, (int64_t)timeout_ns);
    store(books->words + CORE_HEARTBEAT_NS, monotonic_ns());
    return error;
}

static PyObject *books_work(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    struct books_object *object = books_of(self);
    uint64_t records_per_turn, heartbeat_ns;
    struct wakeup *wakeup = count == 4 ? wakeup_of(arguments[0]) : NULL;
    if (wakeup == NULL || wakeup->posts == NULL || object->links == NULL) {
        PyErr_SetString(PyExc_TypeError, "expected the post of a wake-up in C, and the links to be set");
        return NULL;
    }
    int is_special = PyObject_IsTrue(arguments[3]);
    if (!read_number(arguments[1], &records_per_turn) || !read_number(arguments[2], &heartbeat_ns) ||
        is_special < 0)
        return NULL;
    object->router.is_special = is_special;
    MAY_DIE(return NULL);
    uint64_t end_ns = monotonic_ns() + heartbeat_ns;
    do {
        int error = sleep_as_core(&object->books, wakeup, heartbeat_ns);
        if (error == ETIMEDOUT || error == EINTR)
            break;
        if (error != 0) {
            errno = error;
            return PyErr_SetFromErrno(PyExc_OSError);
        }
        do {
            struct link *link = go_on(object, records_per_turn);
            if (PyErr_Occurred())
                return NULL;
            if (link != NULL)
                return Py_NewRef(object_of(link));
        } while ((object->router.round.unfinished_count != 0 || before_sleep(&object->books)) &&
                 monotonic_ns() < end_ns);
    } while (monotonic_ns() < end_ns);
    Py_RETURN_NONE;
}

static PyObject *get_left(PyObject *self, void *Py_UNUSED(closure))
{
    uint64_t left = books_of(self)->router.round.left;
    if (left == UINT64_MAX)
        Py_RETURN_NONE;
    return PyLong_FromUnsignedLongLong(left);
}

static PyObject *get_is_unfinished(PyObject *self, void *Py_UNUSED(closure))
{
    return PyBool_FromLong(books_of(self)->router.round.unfinished_count != 0);
}

static PyMemberDef books_members[] = {
    {"is_wanting", T_BOOL, offsetof(struct books_object, books.is_wanting), 0, NULL},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef books_attributes[] = {
    {"left", get_left, NULL, "Records of a turn behind the one to be handled; None: the ring is corrupt.", NULL},
    {"is_unfinished", get_is_unfinished, NULL, "Whether rings have more records than the round handled.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyMethodDef books_methods[] = {
    {"set_links", books_set_links, METH_O, "Set the links that are connected."},
    {"serve_round", (PyCFunction)(void (*)(void))books_serve_round, METH_FASTCALL,
     "Begin or go on with a round; return a link of which Python must handle a record, None when it is over."},
    {"set_slots", books_set_slots, METH_O, "Set the slots, in order; once."},
    {"references", books_references, METH_NOARGS, "Return a new, empty list of references."},
    {"enter", books_enter, METH_O, "Enter a subscription under its row."},
    {"outdate", books_outdate, METH_O, "Note that the figures of a slot must be written again."},
    {"note_post", books_note_post, METH_O, "Have a link be woken, for it has been sent records."},
    {"post", books_post, METH_NOARGS, "Wake the links that have been sent records."},
    {"write_figures", books_write_figures, METH_NOARGS, "Write the figures that have changed."},
    {"somebody_waits", books_somebody_waits, METH_NOARGS, "Whether messages wait for a module."},
    {"before_sleep", books_before_sleep, METH_NOARGS,
     "Ask modules to post on a release, or not to; return whether the rings must be looked at again."},
    {"work", (PyCFunction)(void (*)(void))books_work, METH_FASTCALL,
     "Wait for posts and handle what is common, until Python must do something."},
    {"serve", (PyCFunction)(void (*)(void))books_serve, METH_FASTCALL,
     "Handle the next records of a link as far as they are common; return how many were."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject books_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Books",
    .tp_doc = "What the core knows of a run besides its tables, and the hot path over it.",
    .tp_basicsize = sizeof(struct books_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = PyType_GenericNew,
    .tp_init = books_init,
    .tp_dealloc = books_free,
    .tp_traverse = books_traverse,
    .tp_clear = books_clear,
    .tp_methods = books_methods,
    .tp_members = books_members,
    .tp_getset = books_attributes,
};

int add_books_types(PyObject *module)
{
    PyTypeObject *public_types[] = {&free_rows_type,    &references_type, &subscription_type, &channel_type,
                                    &link_type, &slot_type, &books_type};
    if (PyType_Ready(&iterator_type) != 0)
        return -1;
    for (size_t index = 0; index < sizeof public_types / sizeof *public_types; index++)
        if (PyModule_AddType(module, public_types[index]) != 0)
            return -1;
    return 0;
}
