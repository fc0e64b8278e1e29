/* The four ends of rings as Python types, with the interface of robbie_mp/bus/transport/ring.py. */
#include "ring_bindings.h"
#include <stddef.h>

static int word_attribute(PyObject *object, const char *name, uint64_t *value)
{
    PyObject *attribute = PyObject_GetAttrString(object, name);
    if (attribute == NULL)
        return -1;
    *value = PyLong_AsUnsignedLongLong(attribute);
    Py_DECREF(attribute);
    return PyErr_Occurred() ? -1 : 0;
}

static int words_attribute(PyObject *object, const char *name, struct held_words *held, bool writable)
{
    PyObject *attribute = PyObject_GetAttrString(object, name);
    if (attribute == NULL)
        return -1;
    int result = hold_words(held, attribute, writable);
    Py_DECREF(attribute);
    return result;
}

int hold_ring_place(struct ring_place *place, struct held_words *words, struct held_words *tail_words,
                    PyObject *ring_place, int record_words, bool is_writer)
{
    uint64_t head_at, records_at, tail_at, capacity;
    if (word_attribute(ring_place, "head_at", &head_at) != 0 ||
        word_attribute(ring_place, "records_at", &records_at) != 0 ||
        word_attribute(ring_place, "tail_at", &tail_at) != 0 ||
        word_attribute(ring_place, "capacity", &capacity) != 0)
        return -1;
    if (words_attribute(ring_place, "words", words, is_writer) != 0)
        return -1;
    if (words_attribute(ring_place, "tail_words", tail_words, !is_writer) != 0) {
        release_words(words);
        return -1;
    }
    uint64_t count = (uint64_t)words->count;
    if (head_at >= count || records_at > count || capacity == 0 || (capacity & (capacity - 1)) != 0 ||
        capacity > (count - records_at) / (uint64_t)record_words || tail_at >= (uint64_t)tail_words->count) {
        release_words(words);
        release_words(tail_words);
        PyErr_SetString(PyExc_ValueError, "the ring does not fit into its memory");
        return -1;
    }
    *place = (struct ring_place){
        words->words + head_at, words->words + records_at, tail_words->words + tail_at, capacity};
    return 0;
}

/* -- what all four ends have in common ---------------------------------------------------------------------- */

static void raise_corrupt(const char *format, ...)
{
    PyObject *module = PyImport_ImportModule("robbie_mp.bus.transport.ring");
    PyObject *type = module == NULL ? NULL : PyObject_GetAttrString(module, "RingCorrupt");
    Py_XDECREF(module);
    if (type == NULL)
        return;
    va_list values;
    va_start(values, format);
    PyErr_FormatV(type, format, values);
    va_end(values);
    Py_DECREF(type);
}

static void raise_unusable(bool is_disowned)
{
    if (is_disowned)
        raise_forked_process();
    else
        PyErr_SetString(PyExc_ValueError, "this end of a ring was closed");
}

/* The words that an argument of a record holds; false with an exception set if it is no word. */
static bool read_words(PyObject *const *arguments, Py_ssize_t count, Py_ssize_t wanted, uint64_t *words)
{
    if (count != wanted) {
        PyErr_Format(PyExc_TypeError, "expected %zd words, got %zd", wanted, count);
        return false;
    }
    for (Py_ssize_t index = 0; index < count; index++) {
        PyObject *number = PyNumber_Index(arguments[index]);
        if (number == NULL)
            return false;
        words[index] = PyLong_AsUnsignedLongLong(number);
        Py_DECREF(number);
        if (PyErr_Occurred())
            return false;
    }
    return true;
}

/* Read the one argument `place`, and hold its memory; 0 or -1. */
static int take_place(PyObject *args, PyObject *named, struct ring_place *place, struct held_words *words,
                      struct held_words *tail_words, int record_words, bool is_writer)
{
    static char *names[] = {"place", NULL};
    PyObject *ring_place;
    if (!PyArg_ParseTupleAndKeywords(args, named, "O", names, &ring_place))
        return -1;
    if (words->words != NULL) {
        PyErr_SetString(PyExc_TypeError, "an end of a ring is made only once");
        return -1;
    }
    return hold_ring_place(place, words, tail_words, ring_place, record_words, is_writer);
}

static PyObject *word_of(uint64_t word)
{
    return PyLong_FromUnsignedLongLong(word);
}

/* -- writing ends ------------------------------------------------------------------------------------------- */

static struct ring_writer *writer_of(PyObject *self)
{
    struct ring_writer_object *end = (struct ring_writer_object *)self;
    if (end->words.words != NULL)
        return &end->ring;
    raise_unusable(end->is_disowned);
    return NULL;
}

static int make_writer(PyObject *self, PyObject *args, PyObject *named, int record_words)
{
    struct ring_writer_object *end = (struct ring_writer_object *)self;
    struct ring_place place;
    if (take_place(args, named, &place, &end->words, &end->tail_words, record_words, true) != 0)
        return -1;
    end->ring = ring_writer_at(place);
    end->is_disowned = false;
    return 0;
}

static int ring_writer_init(PyObject *self, PyObject *args, PyObject *named)
{
    return make_writer(self, args, named, RECORD_WORDS);
}

static int number_ring_writer_init(PyObject *self, PyObject *args, PyObject *named)
{
    return make_writer(self, args, named, 1);
}

static void release_writer(struct ring_writer_object *end)
{
    end->ring = (struct ring_writer){{NULL, NULL, NULL, 0}, end->ring.head};
    release_words(&end->words);
    release_words(&end->tail_words);
}

static PyObject *close_writer(PyObject *self, PyObject *Py_UNUSED(none))
{
    release_writer((struct ring_writer_object *)self);
    Py_RETURN_NONE;
}

static PyObject *disown_writer(PyObject *self, PyObject *Py_UNUSED(none))
{
    ((struct ring_writer_object *)self)->is_disowned = true;
    return close_writer(self, NULL);
}

static void free_writer(PyObject *self)
{
    release_writer((struct ring_writer_object *)self);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *get_head(PyObject *self, void *Py_UNUSED(closure))
{
    return word_of(((struct ring_writer_object *)self)->ring.head);
}

static int set_head(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    uint64_t head;
    if (value == NULL || !read_words(&value, 1, 1, &head))
        return -1;
    ((struct ring_writer_object *)self)->ring.head = head;
    return 0;
}

static PyObject *writer_room(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct ring_writer *ring = writer_of(self);
    return ring == NULL ? NULL : word_of(ring_room(ring));
}

static PyObject *writer_push(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    uint64_t record[7];
    struct ring_writer *ring = writer_of(self);
    if (ring == NULL || !read_words(arguments, count, 7, record))
        return NULL;
    MAY_DIE(return NULL);
    ring_push(ring, record);
    Py_RETURN_NONE;
}

static PyObject *number_writer_push(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    uint64_t number;
    struct ring_writer *ring = writer_of(self);
    if (ring == NULL || !read_words(arguments, count, 1, &number))
        return NULL;
    MAY_DIE(return NULL);
    number_ring_push(ring, number);
    Py_RETURN_NONE;
}

static PyGetSetDef writer_attributes[] = {
    {"head", get_head, set_head, "Number of records that were ever pushed.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyMethodDef ring_writer_methods[] = {
    {"room", writer_room, METH_NOARGS, "Records that can be pushed now."},
    {"push", (PyCFunction)(void (*)(void))writer_push, METH_FASTCALL, "Append one record of seven words."},
    {"close", close_writer, METH_NOARGS, "Let go of the memory."},
    {"disown", disown_writer, METH_NOARGS, "Let go of the memory, in a forked process."},
    {NULL, NULL, 0, NULL},
};

static PyMethodDef number_ring_writer_methods[] = {
    {"push", (PyCFunction)(void (*)(void))number_writer_push, METH_FASTCALL, "Append a number."},
    {"close", close_writer, METH_NOARGS, "Let go of the memory."},
    {"disown", disown_writer, METH_NOARGS, "Let go of the memory, in a forked process."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject ring_writer_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.RingWriter",
    .tp_doc = "The writing end; see robbie_mp.bus.transport.ring.RingWriter.",
    .tp_basicsize = sizeof(struct ring_writer_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_init = ring_writer_init,
    .tp_dealloc = free_writer,
    .tp_getset = writer_attributes,
    .tp_methods = ring_writer_methods,
};

PyTypeObject number_ring_writer_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.NumberRingWriter",
    .tp_doc = "The writing end of a ring of numbers; see robbie_mp.bus.transport.ring.NumberRingWriter.",
    .tp_basicsize = sizeof(struct ring_writer_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_init = number_ring_writer_init,
    .tp_dealloc = free_writer,
    .tp_getset = writer_attributes,
    .tp_methods = number_ring_writer_methods,
};

/* -- reading ends ------------------------------------------------------------------------------------------- */

static struct ring_reader *reader_of(PyObject *self)
{
    struct ring_reader_object *end = (struct ring_reader_object *)self;
    if (end->words.words != NULL)
        return &end->ring;
    raise_unusable(end->is_disowned);
    return NULL;
}

static int make_reader(PyObject *self, PyObject *args, PyObject *named, int record_words)
{
    struct ring_reader_object *end = (struct ring_reader_object *)self;
    struct ring_place place;
    if (take_place(args, named, &place, &end->words, &end->tail_words, record_words, false) != 0)
        return -1;
    end->ring = ring_reader_at(place);
    end->is_disowned = false;
    return 0;
}

static int ring_reader_init(PyObject *self, PyObject *args, PyObject *named)
{
    return make_reader(self, args, named, RECORD_WORDS);
}

static int number_ring_reader_init(PyObject *self, PyObject *args, PyObject *named)
{
    return make_reader(self, args, named, 1);
}

static void release_reader(struct ring_reader_object *end)
{
    end->ring.place = (struct ring_place){NULL, NULL, NULL, 0};
    release_words(&end->words);
    release_words(&end->tail_words);
}

static PyObject *close_reader(PyObject *self, PyObject *Py_UNUSED(none))
{
    release_reader((struct ring_reader_object *)self);
    Py_RETURN_NONE;
}

static PyObject *disown_reader(PyObject *self, PyObject *Py_UNUSED(none))
{
    ((struct ring_reader_object *)self)->is_disowned = true;
    return close_reader(self, NULL);
}

static void free_reader(PyObject *self)
{
    release_reader((struct ring_reader_object *)self);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *get_tail(PyObject *self, void *Py_UNUSED(closure))
{
    return word_of(((struct ring_reader_object *)self)->ring.tail);
}

/* Raise RingCorrupt if more records wait than the ring can hold; false if so. */
static bool check_waiting(const struct ring_reader *ring, uint64_t waiting)
{
    if (waiting <= ring->place.capacity)
        return true;
    uint64_t head = ring->tail + waiting; /* before the tail: a negative number of records */
    bool is_before = head < ring->tail;
    raise_corrupt("a ring of %llu records claims that %s%llu wait", (unsigned long long)ring->place.capacity,
                  is_before ? "-" : "", (unsigned long long)(is_before ? ring->tail - head : waiting));
    return false;
}

static PyObject *reader_waiting(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct ring_reader *ring = reader_of(self);
    if (ring == NULL)
        return NULL;
    uint64_t waiting = ring_waiting(ring);
    return check_waiting(ring, waiting) ? word_of(waiting) : NULL;
}

/* Copy the record at the tail; false with RingCorrupt set if it is not numbered as it must be. */
static bool read_record(const struct ring_reader *ring, uint64_t record[8])
{
    if (ring_peek(ring, record))
        return true;
    raise_corrupt("record %llu of a ring is numbered %llu", (unsigned long long)ring->tail,
                  (unsigned long long)record[7]);
    return false;
}

static PyObject *tuple_of(const uint64_t record[8])
{
    PyObject *tuple = PyTuple_New(RECORD_WORDS);
    for (Py_ssize_t word = 0; tuple != NULL && word < RECORD_WORDS; word++) {
        PyObject *value = word_of(record[word]);
        if (value == NULL)
            Py_CLEAR(tuple);
        else
            PyTuple_SET_ITEM(tuple, word, value);
    }
    return tuple;
}

static PyObject *reader_peek(PyObject *self, PyObject *Py_UNUSED(none))
{
    uint64_t record[8];
    struct ring_reader *ring = reader_of(self);
    return ring == NULL || !read_record(ring, record) ? NULL : tuple_of(record);
}

static PyObject *reader_glance(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct ring_reader *ring = reader_of(self);
    return ring == NULL ? NULL : word_of(ring_glance(ring));
}

static PyObject *reader_take(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct ring_reader *ring = reader_of(self);
    if (ring == NULL)
        return NULL;
    MAY_DIE(return NULL);
    ring_take(ring);
    Py_RETURN_NONE;
}

static PyObject *reader_next(PyObject *self, PyObject *Py_UNUSED(none))
{
    uint64_t record[8];
    struct ring_reader *ring = reader_of(self);
    if (ring == NULL)
        return NULL;
    if (ring->tail == ring->looked_up_to) {
        uint64_t waiting = ring_waiting(ring);
        if (waiting == 0)
            Py_RETURN_NONE;
        if (!check_waiting(ring, waiting))
            return NULL;
        ring->looked_up_to = ring->tail + waiting;
    }
    if (!read_record(ring, record))
        return NULL;
    PyObject *tuple = tuple_of(record);
    if (tuple == NULL)
        return NULL;
    MAY_DIE(Py_DECREF(tuple); return NULL);
    ring_take(ring);
    return tuple;
}

static PyObject *reader_take_all(PyObject *self, PyObject *Py_UNUSED(none))
{
    struct ring_reader *ring = reader_of(self);
    if (ring == NULL)
        return NULL;
    uint64_t waiting = ring_waiting(ring);
    if (!check_waiting(ring, waiting))
        return NULL;
    PyObject *list = PyList_New((Py_ssize_t)waiting);
    if (list == NULL || waiting == 0)
        return list;
    for (uint64_t index = 0; index < waiting; index++) {
        PyObject *number = word_of(number_ring_at(ring, index));
        if (number == NULL) {
            Py_DECREF(list);
            return NULL;
        }
        PyList_SET_ITEM(list, (Py_ssize_t)index, number);
    }
    MAY_DIE(Py_DECREF(list); return NULL);
    number_ring_take(ring, waiting);
    return list;
}

static PyGetSetDef reader_attributes[] = {
    {"tail", get_tail, NULL, "Number of records that were ever taken.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyMethodDef ring_reader_methods[] = {
    {"waiting", reader_waiting, METH_NOARGS, "Records that can be read now."},
    {"peek", reader_peek, METH_NOARGS, "Read the record at the tail."},
    {"glance", reader_glance, METH_NOARGS, "Return the first word at the tail, unchecked."},
    {"take", reader_take, METH_NOARGS, "Advance the tail."},
    {"next", reader_next, METH_NOARGS, "Read the record at the tail and advance it; None if there is none."},
    {"close", close_reader, METH_NOARGS, "Let go of the memory."},
    {"disown", disown_reader, METH_NOARGS, "Let go of the memory, in a forked process."},
    {NULL, NULL, 0, NULL},
};

static PyMethodDef number_ring_reader_methods[] = {
    {"take_all", reader_take_all, METH_NOARGS, "Take all numbers in the ring."},
    {"close", close_reader, METH_NOARGS, "Let go of the memory."},
    {"disown", disown_reader, METH_NOARGS, "Let go of the memory, in a forked process."},
    {NULL, NULL, 0, NULL},
};

PyTypeObject ring_reader_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.RingReader",
    .tp_doc = "The reading end; see robbie_mp.bus.transport.ring.RingReader.",
    .tp_basicsize = sizeof(struct ring_reader_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_init = ring_reader_init,
    .tp_dealloc = free_reader,
    .tp_getset = reader_attributes,
    .tp_methods = ring_reader_methods,
};

PyTypeObject number_ring_reader_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.NumberRingReader",
    .tp_doc = "The reading end of a ring of numbers; see robbie_mp.bus.transport.ring.NumberRingReader.",
    .tp_basicsize = sizeof(struct ring_reader_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = PyType_GenericNew,
    .tp_init = number_ring_reader_init,
    .tp_dealloc = free_reader,
    .tp_getset = reader_attributes,
    .tp_methods = number_ring_reader_methods,
};

int add_ring_types(PyObject *module)
{
    if (PyModule_AddType(module, &ring_writer_type) != 0 || PyModule_AddType(module, &ring_reader_type) != 0 ||
        PyModule_AddType(module, &number_ring_writer_type) != 0)
        return -1;
    return PyModule_AddType(module, &number_ring_reader_type);
}
