/* A publisher's blocks; the same as robbie_mp/bus/transport/blocks.py. */
#include "blocks.h"

static uint64_t capacity_for(uint64_t size)
{
    const uint64_t alignment = BLOCK_ALIGNMENT;
    return (size + LEAD_BYTES + alignment - 1) & ~(alignment - 1);
}

PyObject *kept_for(struct kept_blocks_object *self, uint64_t size)
{
    PyObject *capacity = PyLong_FromUnsignedLongLong(capacity_for(size));
    if (capacity == NULL)
        return NULL;
    PyObject *list = PyDict_GetItemWithError(self->kept, capacity);
    Py_DECREF(capacity);
    if (list == NULL || !PyList_CheckExact(list) || PyList_GET_SIZE(list) == 0)
        return NULL;
    PyObject *last = PyList_GET_ITEM(list, PyList_GET_SIZE(list) - 1);
    return Py_IS_TYPE(last, &block_type) ? list : NULL;
}

int take_block(struct kept_blocks_object *self, PyObject *list)
{
    const Py_ssize_t last = PyList_GET_SIZE(list) - 1;
    struct block_object *block = (struct block_object *)PyList_GET_ITEM(list, last);
    PyObject *number = PyLong_FromUnsignedLongLong(self->numbers + 1);
    if (number == NULL)
        return -1;
    int failed = PyDict_SetItem(self->taken, number, (PyObject *)block);
    if (!failed && (failed = PyList_SetSlice(list, last, last + 1, NULL)) != 0)
        (void)PyDict_DelItem(self->taken, number);
    Py_DECREF(number);
    if (failed)
        return -1;
    block->number = ++self->numbers;
    self->taken_bytes += block->capacity;
    return 0;
}

void tell_free_bytes(const struct kept_blocks_object *self, const struct block_object *block)
{
    store(block->words.words + DATA_FREE_BYTES, self->room_bytes - self->taken_bytes);
}

int keep_block(struct kept_blocks_object *self, struct block_object *block)
{
    PyObject *capacity = PyLong_FromUnsignedLongLong(block->capacity);
    if (capacity == NULL)
        return -1;
    PyObject *list = PyDict_GetItemWithError(self->kept, capacity);
    int failed = 0;
    if (list == NULL && !PyErr_Occurred() && (list = PyList_New(0)) != NULL) {
        failed = PyDict_SetItem(self->kept, capacity, list);
        Py_DECREF(list); /* the dict has it, or it failed */
    }
    Py_DECREF(capacity);
    if (list == NULL || failed)
        return -1;
    return PyList_Append(list, (PyObject *)block);
}

int free_block(struct kept_blocks_object *self, uint64_t number)
{
    PyObject *key = PyLong_FromUnsignedLongLong(number);
    if (key == NULL)
        return -1;
    struct block_object *block = (struct block_object *)PyDict_GetItemWithError(self->taken, key);
    int failed = 0;
    if (block != NULL && Py_IS_TYPE(block, &block_type)) {
        Py_INCREF(block); /* keeping it may run a garbage collection */
        failed = PyDict_DelItem(self->taken, key);
        if (!failed) {
            self->taken_bytes -= block->capacity;
            failed = keep_block(self, block);
        }
        Py_DECREF(block);
    }
    Py_DECREF(key);
    return failed || PyErr_Occurred() ? -1 : 0;
}
