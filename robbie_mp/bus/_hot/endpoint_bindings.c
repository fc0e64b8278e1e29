/* A module's end of the bus as a Python object, for the code that publishes and handles messages. */
#include "endpoint_bindings.h"

bool endpoint_is_mine(const struct endpoint_object *self)
{
    return !self->is_disowned && self->outbound->words.words != NULL && self->inbound->words.words != NULL &&
           self->freed->words.words != NULL && self->in_words.words != NULL &&
           PyObject_Size(self->backlog) == 0 && !lock_is_elsewhere(self->lock);
}

int endpoint_wake_core(struct endpoint_object *self)
{
    if (self->core != NULL) {
        wakeup_post(self->core);
        return 0;
    }
    if (lock_take(self->lock) != 0)
        return -1;
    PyObject *result = PyObject_CallNoArgs(self->wake_core);
    lock_give(self->lock);
    Py_XDECREF(result);
    return result == NULL ? -1 : 0;
}

int endpoint_give_back(struct endpoint_object *self, uint64_t kind, uint64_t reference, uint64_t sequence)
{
    MAY_DIE(return -1);
    if (!endpoint_is_mine(self) || !endpoint_return(&self->endpoint, kind, reference, sequence))
        return 0;
    if (endpoint_is_wanted(&self->endpoint) && endpoint_wake_core(self) != 0)
        return -1;
    return 1;
}

PyObject *new_delivery(PyTypeObject *type, const struct delivery *delivery)
{
    const uint64_t words[] = {delivery->declaration, delivery->channel, delivery->reference,
                              delivery->sequence,    delivery->source,  delivery->offset,
                              delivery->size,        delivery->stamp_ns};
    const Py_ssize_t count = sizeof(words) / sizeof(words[0]);
    PyObject *tuple = type->tp_alloc(type, count); /* of a named tuple: its own constructor takes longer */
    for (Py_ssize_t index = 0; tuple != NULL && index < count; index++) {
        PyObject *word = PyLong_FromUnsignedLongLong(words[index]);
        if (word == NULL)
            Py_CLEAR(tuple);
        else
            PyTuple_SET_ITEM(tuple, index, word);
    }
    return tuple;
}
