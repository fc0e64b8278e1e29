/* The Python type History, with the interface of HistoryWriter in robbie_mp/bus/transport/history.py. */
#include "history_bindings.h"
#include <string.h>

enum { HEAD_BYTES = HISTORY_RECORD_WORDS * 8, LARGEST_SHARE = 16, MIN_RING_WORDS = 1024 };

static PyObject *history_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"words", NULL};
    PyObject *words;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O", names, &words))
        return NULL;
    struct history_object *self = (struct history_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    if (hold_words(&self->words, words, true) != 0) {
        Py_DECREF(self);
        return NULL;
    }
    if (self->words.count < HISTORY_RING + MIN_RING_WORDS) {
        Py_DECREF(self);
        PyErr_SetString(PyExc_ValueError, "these words are no history");
        return NULL;
    }
    self->capacity = (uint64_t)(self->words.count - HISTORY_RING) * 8;
    self->most_bytes = self->capacity / LARGEST_SHARE;
    return (PyObject *)self;
}

static void history_dealloc(struct history_object *self)
{
    release_words(&self->words);
    Py_TYPE(self)->tp_free(self);
}

static shared_word *word_at(const struct history_object *self, uint64_t number)
{
    return self->words.words + HISTORY_RING + number % self->capacity / 8;
}

/* Drop the oldest records until this many bytes are free behind the head. */
static void make_room(struct history_object *self, uint64_t head, uint64_t bytes)
{
    shared_word *tail_word = self->words.words + HISTORY_TAIL;
    uint64_t tail = load(tail_word);
    while (head + bytes - tail > self->capacity) {
        const uint64_t whole = load(word_at(self, tail)) >> 32;
        if (whole == 0 || whole > head - tail) {
            tail = head; /* somebody has overwritten it: begin again */
            break;
        }
        tail += whole;
    }
    store(tail_word, tail);
    fence_stores(); /* a process may be killed at any time: what is overwritten is no longer told of */
}

void history_append(struct history_object *self, const struct history_event *event, const void *data, uint64_t size)
{
    if (self == NULL || self->is_disowned || self->words.words == NULL)
        return;
    uint64_t whole = HEAD_BYTES + ((size + 7) & ~(uint64_t)7);
    if (whole > self->most_bytes || size > self->most_bytes)
        whole = HEAD_BYTES;
    shared_word *words = self->words.words;
    uint64_t head = load(words + HISTORY_HEAD);
    const uint64_t left = self->capacity - head % self->capacity;
    const uint64_t padding = left < whole ? left : 0;
    make_room(self, head, whole + padding);
    if (padding != 0) {
        store(word_at(self, head), EVENT_PADDING | padding << 32);
        head += padding;
    }
    shared_word *record = word_at(self, head);
    const uint64_t number = load(words + HISTORY_RECORDS) + 1;
    const uint64_t row[HISTORY_RECORD_WORDS] = {event->kind | whole << 32, number, size, event->time_ns,
                                                event->values[0], event->values[1], event->values[2],
                                                event->values[3]};
    for (int index = 0; index < HISTORY_RECORD_WORDS; index++)
        store(record + index, row[index]);
    if (whole > HEAD_BYTES)
        memcpy(record + HISTORY_RECORD_WORDS, data, size);
    fence_stores();
    store(words + HISTORY_RECORDS, number);
    store(words + HISTORY_HEAD, head + whole);
}

static PyObject *append(struct history_object *self, PyObject *const *arguments, Py_ssize_t count)
{
    struct history_event event = {0};
    uint64_t *const numbers[] = {&event.kind,      &event.time_ns,   &event.values[0],
                                 &event.values[1], &event.values[2], &event.values[3]};
    if (count < 1 || count > 7) {
        PyErr_SetString(PyExc_TypeError, "append takes a kind, a time, four values and data");
        return NULL;
    }
    for (Py_ssize_t index = 0; index < count && index < 6; index++)
        *numbers[index] = PyLong_AsUnsignedLongLongMask(arguments[index]);
    if (PyErr_Occurred())
        return NULL;
    MAY_DIE(return NULL);
    if (count < 7) {
        history_append(self, &event, NULL, 0);
        Py_RETURN_NONE;
    }
    Py_buffer data;
    if (PyObject_GetBuffer(arguments[6], &data, PyBUF_SIMPLE) != 0)
        return NULL;
    history_append(self, &event, data.buf, (uint64_t)data.len);
    PyBuffer_Release(&data);
    Py_RETURN_NONE;
}

static PyObject *let_go(struct history_object *self, PyObject *Py_UNUSED(none))
{
    release_words(&self->words);
    Py_RETURN_NONE;
}

static PyObject *disown(struct history_object *self, PyObject *Py_UNUSED(none))
{
    self->is_disowned = true;
    Py_RETURN_NONE;
}

static PyMethodDef history_methods[] = {
    {"append", (PyCFunction)(void (*)(void))append, METH_FASTCALL,
     "Append an event: its kind, its time, up to four values, its data."},
    {"close", (PyCFunction)let_go, METH_NOARGS, "Let go of the memory."},
    {"disown", (PyCFunction)disown, METH_NOARGS, "Record nothing in a forked process."},
    {0},
};

PyTypeObject history_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.History",
    .tp_doc = "What a module has handled.",
    .tp_basicsize = sizeof(struct history_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = history_new,
    .tp_dealloc = (destructor)history_dealloc,
    .tp_methods = history_methods,
};

int add_history_type(PyObject *module)
{
    return PyModule_AddType(module, &history_type);
}
