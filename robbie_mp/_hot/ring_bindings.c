/* The four ends of rings as Python types, with the interface of robbie_mp/transport/ring.py. */
#include "native.h"
#include <stddef.h>
#include <structmember.h>

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

int add_ring_types(PyObject *module)
{
    (void)module;
    return 0;
}
