/* What robbie_mp/module/outbox.py leaves to C. */
#include "publisher.h"
#include "blocks.h"
#include "endpoint_bindings.h"
#include "history.h"
#include "message_codec.h"
#include "clock.h"

enum { MAX_COLLECTED = 512 }; /* freed blocks at a time; Python collects the others */

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

PyObject *publisher_publish(struct publisher_object *self, PyObject *message_object, PyObject *topic)
{
    struct prepared_message message;
    const int is_mine = prepare(self, message_object, topic, &message);
    if (is_mine == 0)
        Py_RETURN_NONE;
    if (is_mine < 0 || take_prepared(self, &message) != 0 ||
        pass_on(self, message.block, message.declaration, message.size) != 0)
        return NULL;
    return published(self, message.size);
}

PyObject *publisher_publish_encoded(struct publisher_object *self, uint64_t declaration, const void *data, uint64_t size)
{
    struct prepared_message message = {.declaration = declaration, .size = size};
    const int found = find_block(self, &message);
    if (found == 0)
        Py_RETURN_NONE;
    if (found < 0)
        return NULL;
    memcpy(start_of(&message), data, size);
    if (take_prepared(self, &message) != 0 || pass_on(self, message.block, message.declaration, message.size) != 0)
        return NULL;
    return published(self, message.size);
}

PyObject *publisher_hand_over(struct publisher_object *self, struct block_object *block, uint64_t declaration,
                              uint64_t size)
{
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

PyObject *publisher_outstanding(struct publisher_object *self)
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
