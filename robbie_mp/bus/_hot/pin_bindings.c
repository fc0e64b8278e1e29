/* The Python types MappedSegment, Unreferenced, MessageBytes and Pins. */
#include "pin_bindings.h"
#include <structmember.h>

/* -- a segment of another module ---------------------------------------------------------------------------- */

static PyObject *mapped_segment_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"buffer", NULL};
    PyObject *buffer;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O", names, &buffer))
        return NULL;
    struct mapped_segment_object *self = (struct mapped_segment_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    if (hold_words(&self->words, buffer, false) != 0)
        Py_CLEAR(self);
    else if (self->words.count < DATA_BLOCKS) {
        Py_CLEAR(self);
        PyErr_SetString(PyExc_ValueError, "this is not a data segment");
    }
    return (PyObject *)self;
}

static void mapped_segment_dealloc(struct mapped_segment_object *self)
{
    release_words(&self->words);
    Py_TYPE(self)->tp_free(self);
}

PyTypeObject mapped_segment_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.MappedSegment",
    .tp_doc = "A data segment of another module, mapped as long as this object exists.",
    .tp_basicsize = sizeof(struct mapped_segment_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = mapped_segment_new,
    .tp_dealloc = (destructor)mapped_segment_dealloc,
};

/* -- references --------------------------------------------------------------------------------------------- */

static struct reference_node *new_node(uint64_t reference)
{
    struct reference_node *node = PyMem_Malloc(sizeof(*node));
    if (node == NULL)
        PyErr_NoMemory();
    else
        *node = (struct reference_node){NULL, reference};
    return node;
}

static void append_node(struct unreferenced_object *self, struct reference_node *node)
{
    if (self->first == NULL)
        self->first = node;
    else
        self->last->next = node;
    self->last = node;
    self->count++;
}

uint64_t pop_reference(struct unreferenced_object *self)
{
    struct reference_node *node = self->first;
    const uint64_t reference = node->reference;
    self->first = node->next;
    self->count--;
    PyMem_Free(node);
    return reference;
}

static PyObject *unreferenced_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "", (char *[]){NULL}))
        return NULL;
    return type->tp_alloc(type, 0);
}

static void unreferenced_dealloc(struct unreferenced_object *self)
{
    while (self->first != NULL)
        pop_reference(self);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *unreferenced_append(struct unreferenced_object *self, PyObject *number)
{
    const uint64_t reference = PyLong_AsUnsignedLongLong(number);
    struct reference_node *node = PyErr_Occurred() ? NULL : new_node(reference);
    if (node == NULL)
        return NULL;
    append_node(self, node);
    Py_RETURN_NONE;
}

static PyObject *unreferenced_popleft(struct unreferenced_object *self, PyObject *Py_UNUSED(ignored))
{
    if (self->first == NULL) {
        PyErr_SetString(PyExc_IndexError, "there is no reference");
        return NULL;
    }
    return PyLong_FromUnsignedLongLong(pop_reference(self));
}

static PyObject *unreferenced_remove(struct unreferenced_object *self, PyObject *number)
{
    const uint64_t reference = PyLong_AsUnsignedLongLong(number);
    if (PyErr_Occurred())
        return NULL;
    struct reference_node *before = NULL;
    for (struct reference_node *node = self->first; node != NULL; before = node, node = node->next) {
        if (node->reference != reference)
            continue;
        if (before == NULL)
            self->first = node->next;
        else
            before->next = node->next;
        if (self->last == node)
            self->last = before;
        self->count--;
        PyMem_Free(node);
        Py_RETURN_NONE;
    }
    PyErr_SetString(PyExc_ValueError, "there is no such reference");
    return NULL;
}

static Py_ssize_t unreferenced_length(struct unreferenced_object *self)
{
    return self->count;
}

static PyMethodDef unreferenced_methods[] = {
    {"append", (PyCFunction)unreferenced_append, METH_O, "Add a reference."},
    {"popleft", (PyCFunction)unreferenced_popleft, METH_NOARGS, "Take the first reference."},
    {"remove", (PyCFunction)unreferenced_remove, METH_O, "Take out a reference; ValueError: there is none such."},
    {0},
};

static PySequenceMethods unreferenced_as_sequence = {.sq_length = (lenfunc)unreferenced_length};

PyTypeObject unreferenced_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Unreferenced",
    .tp_doc = "References to messages that nothing refers to any more; finalizers add to them, in any thread.",
    .tp_basicsize = sizeof(struct unreferenced_object),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_new = unreferenced_new,
    .tp_dealloc = (destructor)unreferenced_dealloc,
    .tp_methods = unreferenced_methods,
    .tp_as_sequence = &unreferenced_as_sequence,
};

/* -- the bytes of a message --------------------------------------------------------------------------------- */

struct message_bytes_object *new_message_bytes(struct mapped_segment_object *segment, uint64_t start, uint64_t size)
{
    struct message_bytes_object *self = PyObject_New(struct message_bytes_object, &message_bytes_type);
    if (self == NULL)
        return NULL;
    self->segment = (struct mapped_segment_object *)Py_NewRef((PyObject *)segment);
    self->unreferenced = NULL;
    self->node = NULL;
    self->start = start;
    self->size = size;
    return self;
}

int keep_message_bytes(struct message_bytes_object *self, struct unreferenced_object *unreferenced, uint64_t reference)
{
    self->node = new_node(reference);
    if (self->node == NULL)
        return -1;
    self->unreferenced = (struct unreferenced_object *)Py_NewRef((PyObject *)unreferenced);
    return 0;
}

static void message_bytes_dealloc(struct message_bytes_object *self)
{
    if (self->node != NULL)
        append_node(self->unreferenced, self->node);
    Py_XDECREF(self->unreferenced);
    Py_DECREF(self->segment);
    PyObject_Free(self);
}

static int message_bytes_get_buffer(struct message_bytes_object *self, Py_buffer *view, int flags)
{
    return PyBuffer_FillInfo(view, (PyObject *)self, first_byte(self), (Py_ssize_t)self->size, 1, flags);
}

static PyBufferProcs message_bytes_as_buffer = {.bf_getbuffer = (getbufferproc)message_bytes_get_buffer};

PyTypeObject message_bytes_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.MessageBytes",
    .tp_doc = "The bytes of a message in its publisher's memory.",
    .tp_basicsize = sizeof(struct message_bytes_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .tp_dealloc = (destructor)message_bytes_dealloc,
    .tp_as_buffer = &message_bytes_as_buffer,
};

/* -- pins --------------------------------------------------------------------------------------------------- */

static struct pinned_publisher *find_publisher(const struct pins_object *self, uint64_t source)
{
    for (size_t index = 0; index < self->publisher_count; index++)
        if (self->publishers[index].publisher == (source & SOURCE_OF_INCARNATION))
            return &self->publishers[index];
    return NULL;
}

bool pins_have_room(const struct pins_object *self, const struct delivery *delivery, uint64_t free_bytes)
{
    const struct pinned_publisher *pinned = find_publisher(self, delivery->source);
    return pinned == NULL ||
           (pinned->messages < MAX_PINNED && PINNED_SHARE * (pinned->bytes + delivery->size) <= free_bytes);
}

/* Make sure that a publisher can be counted; 0, or -1 with an exception. */
static int count_publisher(struct pins_object *self, uint64_t source)
{
    if (find_publisher(self, source) != NULL)
        return 0;
    if (self->publisher_count == self->publisher_room) {
        const size_t room = 2 * self->publisher_room + 4;
        struct pinned_publisher *publishers = PyMem_Realloc(self->publishers, room * sizeof(*publishers));
        if (publishers == NULL) {
            PyErr_NoMemory();
            return -1;
        }
        self->publishers = publishers;
        self->publisher_room = room;
    }
    self->publishers[self->publisher_count++] = (struct pinned_publisher){source & SOURCE_OF_INCARNATION, 0, 0};
    return 0;
}

/* Count a message of a counted publisher that is pinned, or is no longer. */
static void count_pin(struct pins_object *self, uint64_t source, uint64_t size, bool is_pinned)
{
    struct pinned_publisher *pinned = find_publisher(self, source);
    pinned->messages += is_pinned ? 1 : (uint64_t)-1;
    pinned->bytes += is_pinned ? size : -size;
    self->bytes += is_pinned ? size : -size;
    if (pinned->messages == 0)
        *pinned = self->publishers[--self->publisher_count];
}

static int tell(struct pins_object *self)
{
    if (self->words.words == NULL) {
        PyErr_SetString(PyExc_ValueError, "these pins were closed");
        return -1;
    }
    MAY_DIE(return -1);
    store(self->words.words + OUT_PINNED, (uint64_t)PyDict_GET_SIZE(self->by_reference));
    store(self->words.words + OUT_PINNED_BYTES, self->bytes);
    return 0;
}

/* Pin a message together with an object that is to live as long; 0, or -1 with an exception. */
static int pin(struct pins_object *self, PyObject *delivery, PyObject *with, uint64_t reference, uint64_t source,
               uint64_t size)
{
    PyObject *key = PyLong_FromUnsignedLongLong(reference);
    PyObject *value = key == NULL ? NULL : PyTuple_Pack(2, delivery, with);
    int failed = value == NULL || count_publisher(self, source) != 0 ||
                 PyDict_SetItem(self->by_reference, key, value) != 0;
    Py_XDECREF(key);
    Py_XDECREF(value);
    if (failed)
        return -1;
    count_pin(self, source, size, true);
    return tell(self);
}

int add_pin(struct pins_object *self, const struct delivery *delivery, PyTypeObject *delivery_type)
{
    PyObject *tuple = new_delivery(delivery_type, delivery);
    if (tuple == NULL)
        return -1;
    int failed = pin(self, tuple, Py_None, delivery->reference, delivery->source, delivery->size);
    Py_DECREF(tuple);
    return failed;
}

/* Read a word of a Delivery of records.py; -1 with an exception if it is none. */
static int delivery_word(PyObject *delivery, Py_ssize_t index, uint64_t *word)
{
    if (!PyTuple_Check(delivery) || PyTuple_GET_SIZE(delivery) != 8) {
        PyErr_SetString(PyExc_TypeError, "expected a Delivery");
        return -1;
    }
    *word = PyLong_AsUnsignedLongLong(PyTuple_GET_ITEM(delivery, index));
    return PyErr_Occurred() ? -1 : 0;
}

/* Where a Delivery has these words. */
enum { AT_REFERENCE = 2, AT_SOURCE = 4, AT_SIZE = 6 };

PyObject *remove_pin(struct pins_object *self, uint64_t reference)
{
    uint64_t source, size;
    PyObject *key = PyLong_FromUnsignedLongLong(reference);
    PyObject *value = key == NULL ? NULL : PyDict_GetItemWithError(self->by_reference, key);
    PyObject *delivery = value == NULL ? NULL : Py_NewRef(PyTuple_GET_ITEM(value, 0));
    if (value == NULL && key != NULL && !PyErr_Occurred())
        PyErr_SetObject(PyExc_KeyError, key);
    if (delivery == NULL || delivery_word(delivery, AT_SOURCE, &source) != 0 ||
        delivery_word(delivery, AT_SIZE, &size) != 0 || PyDict_DelItem(self->by_reference, key) != 0) {
        Py_XDECREF(key);
        Py_XDECREF(delivery);
        return NULL;
    }
    Py_DECREF(key);
    count_pin(self, source, size, false);
    if (tell(self) != 0)
        Py_CLEAR(delivery);
    return delivery;
}

static PyObject *pins_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"words", NULL};
    PyObject *words;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O", names, &words))
        return NULL;
    struct pins_object *self = (struct pins_object *)type->tp_alloc(type, 0);
    if (self == NULL || (self->by_reference = PyDict_New()) == NULL || hold_words(&self->words, words, true) != 0)
        Py_CLEAR(self);
    else if (self->words.count < OUT_RING) {
        Py_CLEAR(self);
        PyErr_SetString(PyExc_ValueError, "these are not the words of an outbound segment");
    }
    return (PyObject *)self;
}

static int pins_traverse(struct pins_object *self, visitproc visit, void *arg)
{
    Py_VISIT(self->by_reference);
    return 0;
}

static void pins_dealloc(struct pins_object *self)
{
    PyObject_GC_UnTrack(self);
    release_words(&self->words);
    Py_XDECREF(self->by_reference);
    PyMem_Free(self->publishers);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *pins_add(struct pins_object *self, PyObject *const *arguments, Py_ssize_t count)
{
    uint64_t reference, source, size;
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "add takes a delivery and what is kept with it");
        return NULL;
    }
    if (delivery_word(arguments[0], AT_REFERENCE, &reference) != 0 ||
        delivery_word(arguments[0], AT_SOURCE, &source) != 0 || delivery_word(arguments[0], AT_SIZE, &size) != 0 ||
        pin(self, arguments[0], arguments[1], reference, source, size) != 0)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *pins_remove(struct pins_object *self, PyObject *number)
{
    const uint64_t reference = PyLong_AsUnsignedLongLong(number);
    return PyErr_Occurred() ? NULL : remove_pin(self, reference);
}

static PyObject *pins_have_room_for(struct pins_object *self, PyObject *const *arguments, Py_ssize_t count)
{
    struct delivery delivery = {0};
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "have_room_for takes a delivery and its publisher's free bytes");
        return NULL;
    }
    const uint64_t free_bytes = PyLong_AsUnsignedLongLong(arguments[1]);
    if (PyErr_Occurred() || delivery_word(arguments[0], AT_SOURCE, &delivery.source) != 0 ||
        delivery_word(arguments[0], AT_SIZE, &delivery.size) != 0)
        return NULL;
    return PyBool_FromLong(pins_have_room(self, &delivery, free_bytes));
}

static PyObject *pins_let_go(struct pins_object *self, PyObject *Py_UNUSED(ignored))
{
    release_words(&self->words);
    Py_RETURN_NONE;
}

static Py_ssize_t pins_length(struct pins_object *self)
{
    return PyDict_GET_SIZE(self->by_reference);
}

static PyMethodDef pins_methods[] = {
    {"add", (PyCFunction)(void (*)(void))pins_add, METH_FASTCALL,
     "Pin a delivered message, with an object that is to live as long."},
    {"remove", (PyCFunction)pins_remove, METH_O, "Return the delivery of a message that is no longer pinned."},
    {"have_room_for", (PyCFunction)(void (*)(void))pins_have_room_for, METH_FASTCALL,
     "Whether the limits leave room for a message of a publisher with this number of free bytes."},
    {"close", (PyCFunction)pins_let_go, METH_NOARGS, "Let go of the memory."},
    {0},
};

static PySequenceMethods pins_as_sequence = {.sq_length = (lenfunc)pins_length};

PyTypeObject pins_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Pins",
    .tp_doc = "The messages that a module keeps from being released; see robbie_mp.module.pins.Pins.",
    .tp_basicsize = sizeof(struct pins_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = pins_new,
    .tp_dealloc = (destructor)pins_dealloc,
    .tp_traverse = (traverseproc)pins_traverse,
    .tp_methods = pins_methods,
    .tp_as_sequence = &pins_as_sequence,
};

int add_pin_types(PyObject *module)
{
    PyTypeObject *const types[] = {&mapped_segment_type, &unreferenced_type, &message_bytes_type, &pins_type};
    for (size_t index = 0; index < sizeof(types) / sizeof(types[0]); index++)
        if (PyModule_AddType(module, types[index]) != 0)
            return -1;
    return 0;
}
