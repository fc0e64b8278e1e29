/* Messages in other modules' memory, and what is still in use of them. */
#include "pins.h"

/* -- references --------------------------------------------------------------------------------------------- */

struct reference_node *new_node(uint64_t reference)
{
    struct reference_node *node = PyMem_Malloc(sizeof(*node));
    if (node == NULL)
        PyErr_NoMemory();
    else
        *node = (struct reference_node){NULL, reference};
    return node;
}

void append_node(struct unreferenced_object *self, struct reference_node *node)
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

/* -- the bytes of a message --------------------------------------------------------------------------------- */

struct message_bytes_object *new_message_bytes(struct mapped_segment_object *segment, uint64_t start, uint64_t size)
{
    struct message_bytes_object *self = PyObject_New(struct message_bytes_object, &message_bytes_type);
    if (self == NULL)
        return NULL;
    self->segment = (struct mapped_segment_object *)Py_NewRef((PyObject *)segment);
    self->unreferenced = NULL;
    self->node = NULL;
    self->first = (uint8_t *)segment->words.words + start;
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
    return PyBuffer_FillInfo(view, (PyObject *)self, self->first, (Py_ssize_t)self->size, 1, flags);
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

int pin(struct pins_object *self, PyObject *delivery, PyObject *with, uint64_t reference, uint64_t source,
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
enum { AT_SOURCE = 4, AT_SIZE = 6 };

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

int add_message_bytes_type(PyObject *module)
{
    return PyModule_AddType(module, &message_bytes_type);
}
