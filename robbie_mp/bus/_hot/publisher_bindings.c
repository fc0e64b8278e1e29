/* The Python type Publisher: what robbie_mp/module/outbox.py leaves to C. */
#include "block_bindings.h"
#include "endpoint_bindings.h"
#include "history_bindings.h"
#include "message_codec.h"
#include "clock.h"

enum { MAX_COLLECTED = 512 }; /* freed blocks at a time; Python collects the others */

struct publisher_object {
    PyObject_HEAD
    struct endpoint_object *endpoint;
    struct kept_blocks_object *blocks;
    struct held_words words;
    PyObject *declarations; /* dict: numbers of the channels, by message class and topic */
    PyObject *held; /* dict: blocks of loans whose arrays are referred to after its end; Python frees them */
    struct history_object *history; /* NULL: nothing is recorded */
    uint64_t published_when_asked; /* messages published when `outstanding` was last called */
};

static PyObject *publisher_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"endpoint", "blocks", "words", "declarations", "held", NULL};
    PyObject *endpoint, *blocks, *words, *declarations, *held;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O!O!OO!O!", names, &endpoint_type, &endpoint, &kept_blocks_type,
                                     &blocks, &words, &PyDict_Type, &declarations, &PyDict_Type, &held))
        return NULL;
    struct publisher_object *self = (struct publisher_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    self->endpoint = (struct endpoint_object *)Py_NewRef(endpoint);
    self->blocks = (struct kept_blocks_object *)Py_NewRef(blocks);
    self->declarations = Py_NewRef(declarations);
    self->held = Py_NewRef(held);
    self->published_when_asked = UINT64_MAX;
    if (hold_words(&self->words, words, true) != 0) {
        Py_DECREF(self);
        return NULL;
    }
    if (self->words.count < OUT_RING) {
        Py_DECREF(self);
        PyErr_SetString(PyExc_ValueError, "these are not the words of an outbound segment");
        return NULL;
    }
    return (PyObject *)self;
}

static int publisher_traverse(struct publisher_object *self, visitproc visit, void *arg)
{
    Py_VISIT(self->endpoint);
    Py_VISIT(self->blocks);
    Py_VISIT(self->declarations);
    Py_VISIT(self->held);
    return 0;
}

static void publisher_dealloc(struct publisher_object *self)
{
    PyObject_GC_UnTrack(self);
    release_words(&self->words);
    Py_XDECREF(self->endpoint);
    Py_XDECREF(self->blocks);
    Py_XDECREF(self->declarations);
    Py_XDECREF(self->held);
    Py_XDECREF(self->history);
    Py_TYPE(self)->tp_free(self);
}

/* The channel's number; 0 if it is not declared, or -1 with an exception. */
static int find_declaration(struct publisher_object *self, PyObject *message, PyObject *topic, uint64_t *number)
{
    PyObject *key = PyTuple_Pack(2, (PyObject *)Py_TYPE(message), topic);
    if (key == NULL)
        return -1;
    PyObject *found = PyDict_GetItemWithError(self->declarations, key);
    Py_DECREF(key);
    if (found == NULL)
        return PyErr_Occurred() ? -1 : 0;
    *number = PyLong_AsUnsignedLongLong(found);
    return PyErr_Occurred() ? -1 : 1;
}

/* Return freed blocks to their lists; 1, 0 if this is not mine, -1 with an exception. */
static int collect_freed(struct publisher_object *self)
{
    struct ring_reader *freed = self->endpoint->endpoint.freed;
    const uint64_t count = ring_waiting(freed);
    if (count > freed->place.capacity || PyDict_GET_SIZE(self->held) != 0)
        return 0;
    /* They are taken before they are freed: freeing may make a list, hence run a garbage collection, hence any
     * Python code, which may collect the freed blocks as well. */
    uint64_t numbers[MAX_COLLECTED];
    const uint64_t taken = count < MAX_COLLECTED ? count : MAX_COLLECTED;
    for (uint64_t index = 0; index < taken; index++)
        numbers[index] = number_ring_at(freed, index);
    if (taken != 0) {
        MAY_DIE(return -1);
        number_ring_take(freed, taken);
    }
    for (uint64_t index = 0; index < taken; index++)
        if (free_block(self->blocks, numbers[index]) != 0)
            return -1;
    return taken == count;
}

/* Prepare the next block while the core routes this message; as `collect_freed`. */
static int prepare_next(struct publisher_object *self, uint64_t size)
{
    const struct kept_blocks_object *blocks = self->blocks;
    if (size > MAX_READY_BLOCK_BYTES || kept_for(self->blocks, size) == NULL) {
        int collected = PyErr_Occurred() ? -1 : collect_freed(self);
        if (collected <= 0)
            return collected;
        if (size <= MAX_READY_BLOCK_BYTES && kept_for(self->blocks, size) == NULL)
            return PyErr_Occurred() ? -1 : 0;
    }
    return blocks->taken_bytes + size <= blocks->room_bytes * 7 / 8 &&
           PyDict_GET_SIZE(blocks->taken) <= MAX_IN_FLIGHT;
}

/* A message of the common form, encoded into a block that is still free. */
struct prepared_message {
    uint64_t declaration;
    uint64_t size;
    struct block_object *block; /* the last one in `list`; both are borrowed */
    PyObject *list;
};

/* Find a free block for a message whose declaration and size are known; 1, 0 if this is not mine, -1 with an
 * exception. */
static int find_block(struct publisher_object *self, struct prepared_message *prepared)
{
    if (self->words.words == NULL || !endpoint_is_mine(self->endpoint) ||
        !endpoint_may_publish(&self->endpoint->endpoint) || PyDict_GET_SIZE(self->blocks->taken) >= MAX_OUTSTANDING ||
        (prepared->list = kept_for(self->blocks, prepared->size)) == NULL)
        return PyErr_Occurred() ? -1 : 0;
    prepared->block = (struct block_object *)PyList_GET_ITEM(prepared->list, PyList_GET_SIZE(prepared->list) - 1);
    return 1;
}

static uint8_t *start_of(const struct prepared_message *prepared)
{
    return (uint8_t *)prepared->block->words.buffer.buf + prepared->block->offset;
}

/* Encode a message; 1, 0 if this is not mine, -1 with an exception. Nothing is changed, so that Python can do
 * whatever is not of the common form. Looking up the channel may run Python code, hence another thread: of a
 * topic that is no plain string, or of a garbage collection. What comes after it runs none. */
static int prepare(struct publisher_object *self, PyObject *message, PyObject *topic,
                   struct prepared_message *prepared)
{
    struct message_codec *codec = codec_of(Py_TYPE(message));
    if (codec == NULL || !codec->is_described || !codec->is_installed[FUNCTION_SIZE] ||
        !codec->is_installed[FUNCTION_ENCODE])
        return PyErr_Occurred() ? -1 : 0;
    int found = find_declaration(self, message, topic, &prepared->declaration);
    if (found <= 0)
        return found;
    if (self->words.words == NULL || !endpoint_is_mine(self->endpoint))
        return PyErr_Occurred() ? -1 : 0;
    const Py_ssize_t size = codec_size(codec, message);
    if (size < 0)
        return PyErr_Occurred() ? -1 : 0;
    prepared->size = (uint64_t)size;
    found = find_block(self, prepared);
    if (found <= 0)
        return found;
    if (codec_encode(codec, message, start_of(prepared), size) == size)
        return 1;
    return PyErr_Occurred() ? -1 : 0;
}

/* Pass a message to the core, and count it; 0, or -1 with an exception. */
static int pass_on(struct publisher_object *self, const struct block_object *block, uint64_t declaration,
                   uint64_t size)
{
    const struct placed_message placed = {block->segment, block->offset, size, block->number};
    shared_word *words = self->words.words;
    MAY_DIE(return -1);
    endpoint_publish(&self->endpoint->endpoint, declaration, &placed, monotonic_ns());
    if (endpoint_wake_core(self->endpoint) != 0)
        return -1;
    store(words + OUT_PUBLISHED, load(words + OUT_PUBLISHED) + 1);
    store(words + OUT_BLOCKS, (uint64_t)PyDict_GET_SIZE(self->blocks->taken));
    const struct history_event event = {EVENT_PUBLISHED, 0, {declaration}};
    history_append(self->history, &event, (uint8_t *)block->words.buffer.buf + block->offset, size);
    return 0;
}

/* Take the block of an encoded message into use; 0, or -1 with an exception. */
static int take_prepared(struct publisher_object *self, const struct prepared_message *message)
{
    if (take_block(self->blocks, message->list) != 0)
        return -1;
    MAY_DIE(return -1);
    tell_free_bytes(self->blocks, message->block);
    return 0;
}

/* After a message was passed on: True, or its size, if Python must prepare the next block. */
static PyObject *published(struct publisher_object *self, uint64_t size)
{
    const int is_prepared = prepare_next(self, size);
    if (is_prepared < 0)
        return NULL;
    if (is_prepared)
        Py_RETURN_TRUE;
    return PyLong_FromUnsignedLongLong(size);
}

static PyObject *publish(struct publisher_object *self, PyObject *const *arguments, Py_ssize_t count)
{
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "publish takes a message and a topic");
        return NULL;
    }
    struct prepared_message message;
    const int is_mine = prepare(self, arguments[0], arguments[1], &message);
    if (is_mine == 0)
        Py_RETURN_NONE;
    if (is_mine < 0 || take_prepared(self, &message) != 0 ||
        pass_on(self, message.block, message.declaration, message.size) != 0)
        return NULL;
    return published(self, message.size);
}

static PyObject *publish_encoded(struct publisher_object *self, PyObject *args)
{
    struct prepared_message message;
    unsigned long long declaration;
    Py_buffer source;
    if (!PyArg_ParseTuple(args, "Ky*", &declaration, &source))
        return NULL;
    message.declaration = declaration;
    message.size = (uint64_t)source.len;
    int done = find_block(self, &message);
    if (done > 0) {
        memcpy(start_of(&message), source.buf, (size_t)source.len);
        if (take_prepared(self, &message) != 0 ||
            pass_on(self, message.block, message.declaration, message.size) != 0)
            done = -1;
    }
    PyBuffer_Release(&source);
    if (done == 0)
        Py_RETURN_NONE;
    return done < 0 ? NULL : published(self, message.size);
}

static PyObject *hand_over(struct publisher_object *self, PyObject *args)
{
    struct block_object *block;
    unsigned long long declaration, size;
    if (!PyArg_ParseTuple(args, "KO!K", &declaration, &block_type, &block, &size))
        return NULL;
    if (self->words.words == NULL || !endpoint_is_mine(self->endpoint) ||
        !endpoint_may_publish(&self->endpoint->endpoint)) {
        if (PyErr_Occurred())
            return NULL;
        Py_RETURN_NONE;
    }
    if (pass_on(self, block, declaration, size) != 0)
        return NULL;
    return published(self, size);
}

static PyObject *outstanding(struct publisher_object *self, PyObject *Py_UNUSED(none))
{
    if (self->words.words == NULL || !endpoint_is_mine(self->endpoint) || collect_freed(self) <= 0) {
        if (PyErr_Occurred())
            return NULL;
        Py_RETURN_NONE;
    }
    const Py_ssize_t taken = PyDict_GET_SIZE(self->blocks->taken);
    const uint64_t published = load(self->words.words + OUT_PUBLISHED);
    if (taken != 0 && published == self->published_when_asked && endpoint_wake_core(self->endpoint) != 0)
        return NULL;
    self->published_when_asked = published;
    return PyLong_FromSsize_t(taken);
}

static PyObject *let_go(struct publisher_object *self, PyObject *Py_UNUSED(ignored))
{
    release_words(&self->words);
    PyDict_Clear(self->declarations); /* so no message is of the common form any more */
    Py_RETURN_NONE;
}

static PyObject *record_into(struct publisher_object *self, PyObject *history)
{
    if (!PyObject_TypeCheck(history, &history_type)) {
        PyErr_SetString(PyExc_TypeError, "expected a History");
        return NULL;
    }
    Py_XSETREF(self->history, (struct history_object *)Py_NewRef(history));
    Py_RETURN_NONE;
}

static PyMethodDef publisher_methods[] = {
    {"record_into", (PyCFunction)record_into, METH_O, "Record from now on what is published."},
    {"publish", (PyCFunction)(void (*)(void))publish, METH_FASTCALL,
     "Publish a message: True; its size, if Python must prepare the next block; None if this is not mine."},
    {"publish_encoded", (PyCFunction)publish_encoded, METH_VARARGS,
     "Publish an encoded message, as `publish`: its channel's number, its bytes."},
    {"hand_over", (PyCFunction)hand_over, METH_VARARGS,
     "Publish a block in use that holds a message, as `publish`: its channel's number, the block, its size."},
    {"outstanding", (PyCFunction)outstanding, METH_NOARGS,
     "The number of messages that subscribers wait for or hold; None if this is not mine."},
    {"close", (PyCFunction)let_go, METH_NOARGS, "Let go of the memory."},
    {0},
};

static PyTypeObject publisher_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Publisher",
    .tp_doc = "The common form of what robbie_mp.module.outbox.Outbox.publish does.",
    .tp_basicsize = sizeof(struct publisher_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = publisher_new,
    .tp_dealloc = (destructor)publisher_dealloc,
    .tp_traverse = (traverseproc)publisher_traverse,
    .tp_methods = publisher_methods,
};

int add_publisher_type(PyObject *module)
{
    return PyModule_AddType(module, &publisher_type);
}
