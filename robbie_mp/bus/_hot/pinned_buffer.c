/* An object that keeps another one alive for the views made of its buffer. */
#include "message_codec.h"

/* A view of a view refers to what the first one shows, not to the first view itself; of this object it refers
 * to this object, and this object keeps what it was given. */
struct pinned_buffer {
    PyObject_HEAD
    Py_buffer buffer;
};

static void pinned_dealloc(PyObject *self)
{
    PyBuffer_Release(&((struct pinned_buffer *)self)->buffer);
    Py_TYPE(self)->tp_free(self);
}

static int pinned_get_buffer(PyObject *self, Py_buffer *view, int flags)
{
    Py_buffer *held = &((struct pinned_buffer *)self)->buffer;
    return PyBuffer_FillInfo(view, self, held->buf, held->len, held->readonly, flags);
}

static PyBufferProcs pinned_as_buffer = {.bf_getbuffer = pinned_get_buffer};

static PyTypeObject pinned_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.PinnedBuffer",
    .tp_doc = "Keeps the object that a message was decoded from, for its arrays.",
    .tp_basicsize = sizeof(struct pinned_buffer),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .tp_dealloc = pinned_dealloc,
    .tp_as_buffer = &pinned_as_buffer,
};

PyObject *pinned_buffer(PyObject *buffer, int flags)
{
    struct pinned_buffer *pinned = (struct pinned_buffer *)pinned_type.tp_alloc(&pinned_type, 0);
    if (pinned != NULL && PyObject_GetBuffer(buffer, &pinned->buffer, flags) != 0)
        Py_CLEAR(pinned); /* releasing a buffer that was not got does nothing */
    return (PyObject *)pinned;
}

int ready_pinned_buffer(void)
{
    return PyType_Ready(&pinned_type);
}
