/* The Python types Block and KeptBlocks, with the interface of those in robbie_mp/bus/transport/blocks.py. */
#include "block_bindings.h"
#include <structmember.h>

static PyObject *block_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"number", "segment", "offset", "buffer", "capacity", "words", NULL};
    unsigned long long number, segment, offset, capacity;
    PyObject *memory, *words;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "KKKOKO", names, &number, &segment, &offset, &memory, &capacity, &words))
        return NULL;
    struct block_object *self = (struct block_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    if (hold_words(&self->words, words, true) != 0) {
        Py_DECREF(self);
        return NULL;
    }
    self->number = number;
    self->segment = segment;
    self->offset = offset;
    self->capacity = capacity;
    self->memory = Py_NewRef(memory);
    const unsigned long long bytes = (unsigned long long)self->words.buffer.len;
    if (self->words.count < DATA_BLOCKS || offset < LEAD_BYTES || offset > bytes ||
        capacity > bytes - (offset - LEAD_BYTES) || capacity < LEAD_BYTES) {
        Py_DECREF(self);
        PyErr_SetString(PyExc_ValueError, "the block does not fit into its memory");
        return NULL;
    }
    return (PyObject *)self;
}

static void block_dealloc(struct block_object *self)
{
    release_words(&self->words);
    Py_XDECREF(self->memory);
    Py_TYPE(self)->tp_free(self);
}

static PyMemberDef block_members[] = {
    {"number", T_ULONGLONG, offsetof(struct block_object, number), 0, "Unique within the incarnation."},
    {"segment", T_ULONGLONG, offsetof(struct block_object, segment), READONLY, "Number of the data segment."},
    {"offset", T_ULONGLONG, offsetof(struct block_object, offset), READONLY, "Where the message starts in it."},
    {"capacity", T_ULONGLONG, offsetof(struct block_object, capacity), READONLY, "Its size in bytes."},
    {"buffer", T_OBJECT, offsetof(struct block_object, memory), READONLY, "The whole segment, writable."},
    {0},
};

PyTypeObject block_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Block",
    .tp_doc = "A part of a data segment that holds one message.",
    .tp_basicsize = sizeof(struct block_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = block_new,
    .tp_dealloc = (destructor)block_dealloc,
    .tp_members = block_members,
};

/* -- kept blocks ----------------------------------------------------------------------------------- */

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

/* Put a free block into its list, without counting it. */
static int keep(struct kept_blocks_object *self, struct block_object *block)
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
            failed = keep(self, block);
        }
        Py_DECREF(block);
    }
    Py_DECREF(key);
    return failed || PyErr_Occurred() ? -1 : 0;
}

static PyObject *kept_blocks_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "", (char *[]){NULL}))
        return NULL;
    struct kept_blocks_object *self = (struct kept_blocks_object *)type->tp_alloc(type, 0);
    if (self == NULL || (self->taken = PyDict_New()) == NULL || (self->kept = PyDict_New()) == NULL)
        Py_CLEAR(self);
    return (PyObject *)self;
}

static int kept_blocks_traverse(struct kept_blocks_object *self, visitproc visit, void *arg)
{
    Py_VISIT(self->taken);
    Py_VISIT(self->kept);
    return 0;
}

static void kept_blocks_dealloc(struct kept_blocks_object *self)
{
    PyObject_GC_UnTrack(self);
    Py_XDECREF(self->taken);
    Py_XDECREF(self->kept);
    Py_TYPE(self)->tp_free(self);
}

static int size_of(PyObject *argument, uint64_t *size)
{
    *size = PyLong_AsUnsignedLongLong(argument);
    if (PyErr_Occurred())
        return -1;
    if (*size > (uint64_t)PY_SSIZE_T_MAX) {
        PyErr_SetString(PyExc_OverflowError, "no message is so large");
        return -1;
    }
    return 0;
}

static PyObject *kept_blocks_reuse(struct kept_blocks_object *self, PyObject *argument)
{
    uint64_t size;
    if (size_of(argument, &size) != 0)
        return NULL;
    PyObject *list = kept_for(self, size);
    if (list == NULL) {
        if (PyErr_Occurred())
            return NULL;
        Py_RETURN_NONE;
    }
    struct block_object *block = (struct block_object *)PyList_GET_ITEM(list, PyList_GET_SIZE(list) - 1);
    if (take_block(self, list) != 0)
        return NULL;
    MAY_DIE(return NULL);
    tell_free_bytes(self, block);
    return Py_NewRef((PyObject *)block);
}

static PyObject *kept_blocks_has(struct kept_blocks_object *self, PyObject *argument)
{
    uint64_t size;
    if (size_of(argument, &size) != 0)
        return NULL;
    PyObject *list = kept_for(self, size);
    return list == NULL && PyErr_Occurred() ? NULL : PyBool_FromLong(list != NULL);
}

static PyObject *kept_blocks_keep(struct kept_blocks_object *self, PyObject *block)
{
    if (!PyObject_TypeCheck(block, &block_type)) {
        PyErr_SetString(PyExc_TypeError, "expected a Block");
        return NULL;
    }
    if (keep(self, (struct block_object *)block) != 0)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *kept_blocks_free(struct kept_blocks_object *self, PyObject *numbers)
{
    PyObject *number, *iterator = PyObject_GetIter(numbers);
    if (iterator == NULL)
        return NULL;
    while ((number = PyIter_Next(iterator)) != NULL) {
        const uint64_t value = PyLong_AsUnsignedLongLong(number);
        Py_DECREF(number);
        if (PyErr_Occurred() || free_block(self, value) != 0)
            break;
    }
    Py_DECREF(iterator);
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *kept_blocks_clear(struct kept_blocks_object *self, PyObject *Py_UNUSED(ignored))
{
    PyDict_Clear(self->taken);
    PyDict_Clear(self->kept);
    self->taken_bytes = 0;
    Py_RETURN_NONE;
}

static PyMethodDef kept_blocks_methods[] = {
    {"reuse", (PyCFunction)kept_blocks_reuse, METH_O, "Return a kept block for a message of this size, or None."},
    {"has_kept", (PyCFunction)kept_blocks_has, METH_O, "Whether `reuse` would find a block."},
    {"keep", (PyCFunction)kept_blocks_keep, METH_O, "Keep a new block."},
    {"free", (PyCFunction)kept_blocks_free, METH_O, "Free blocks; numbers that are not in use are ignored."},
    {"clear", (PyCFunction)kept_blocks_clear, METH_NOARGS, "Let all blocks go."},
    {0},
};

static PyMemberDef kept_blocks_members[] = {
    {"taken", T_OBJECT, offsetof(struct kept_blocks_object, taken), READONLY, "Blocks in use, by their numbers."},
    {"kept", T_OBJECT, offsetof(struct kept_blocks_object, kept), READONLY, "Free blocks, by their capacity."},
    {"taken_bytes", T_ULONGLONG, offsetof(struct kept_blocks_object, taken_bytes), READONLY, "Total size of these."},
    {"room_bytes", T_ULONGLONG, offsetof(struct kept_blocks_object, room_bytes), 0, "Bytes that can be used."},
    {0},
};

PyTypeObject kept_blocks_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.KeptBlocks",
    .tp_doc = "The blocks in use and the free ones.",
    .tp_basicsize = sizeof(struct kept_blocks_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = kept_blocks_new,
    .tp_dealloc = (destructor)kept_blocks_dealloc,
    .tp_traverse = (traverseproc)kept_blocks_traverse,
    .tp_methods = kept_blocks_methods,
    .tp_members = kept_blocks_members,
};

int add_block_types(PyObject *module)
{
    return PyModule_AddType(module, &block_type) == 0 ? PyModule_AddType(module, &kept_blocks_type) : -1;
}
