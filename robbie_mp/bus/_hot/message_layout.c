/* The layout of a message of which some arrays are filled later; the same as loans.py. */
#include "message_codec.h"
#include <stddef.h>
#include <structmember.h>

struct message_layout {
    PyObject_HEAD
    struct message_codec *codec;
    PyObject *outline;
    PyObject *fields; /* what it was made of, and ... */
    PyObject *python; /* ... what makes it again in Python, for what C leaves to it */
    Py_ssize_t size;
};

static PyTypeObject layout_type;

PyObject *lay_out(struct message_codec *codec, PyObject *fields, PyObject *python)
{
    PyObject *outline = codec_outline(codec, fields);
    if (outline == NULL)
        return NULL;
    Py_ssize_t size = codec_outline_size(codec, outline);
    struct message_layout *layout =
        size < 0 ? NULL : (struct message_layout *)layout_type.tp_alloc(&layout_type, 0);
    if (layout == NULL) {
        Py_DECREF(outline);
        leave_to_python();
        return NULL;
    }
    layout->codec = (struct message_codec *)Py_NewRef((PyObject *)codec);
    layout->outline = outline;
    layout->fields = Py_NewRef(fields);
    layout->python = Py_NewRef(python);
    layout->size = size;
    return (PyObject *)layout;
}

static bool has_loans(const struct message_layout *layout)
{
    struct message_codec *codec = layout->codec;
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++)
        if (is_loan(field, *slot_of(layout->outline, field)))
            return true;
    return false;
}

/* Write into a buffer; the message, or NULL, without an exception for what is left to Python. */
static PyObject *write_into(struct message_layout *layout, Py_buffer *view, Py_ssize_t start, PyObject *buffer)
{
    uint8_t *to = (uint8_t *)view->buf + start;
    Py_ssize_t room = view->len - start;
    if (!has_loans(layout))
        return codec_encode(layout->codec, layout->outline, to, room) < 0 ? NULL : Py_NewRef(layout->outline);
    PyObject *pin = pinned_buffer(buffer, PyBUF_WRITABLE);
    if (pin == NULL)
        return NULL;
    PyObject *message = codec_encode_outline(layout->codec, layout->outline, to, room, pin);
    Py_DECREF(pin);
    return message;
}

static PyObject *write_in_python(struct message_layout *layout, PyObject *buffer, PyObject *offset)
{
    PyObject *again =
        PyObject_CallFunctionObjArgs(layout->python, layout->codec->message_type, layout->fields, NULL);
    if (again == NULL)
        return NULL;
    PyObject *message = offset == NULL ? PyObject_CallMethod(again, "write", "(O)", buffer)
                                       : PyObject_CallMethod(again, "write", "OO", buffer, offset);
    Py_DECREF(again);
    return message;
}

static PyObject *layout_write(PyObject *self, PyObject *arguments, PyObject *keywords)
{
    struct message_layout *layout = (struct message_layout *)self;
    PyObject *buffer, *offset = NULL;
    static char *names[] = {"buffer", "offset", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "O|O", names, &buffer, &offset))
        return NULL;
    Py_buffer view;
    Py_ssize_t start;
    if (get_room(&view, buffer, offset, &start)) {
        PyObject *message = write_into(layout, &view, start, buffer);
        PyBuffer_Release(&view);
        if (message != NULL)
            return message;
        leave_to_python();
    }
    return PyErr_Occurred() ? NULL : write_in_python(layout, buffer, offset);
}

static PyObject *layout_loaned(PyObject *self, void *Py_UNUSED(closure))
{
    struct message_layout *layout = (struct message_layout *)self;
    struct message_codec *codec = layout->codec;
    PyObject *names = PyFrozenSet_New(NULL);
    for (Py_ssize_t index = 0; names != NULL && index < codec->count; index++) {
        struct message_field *field = &codec->fields[index];
        if (is_loan(field, *slot_of(layout->outline, field)) && PySet_Add(names, field->name) != 0)
            Py_CLEAR(names);
    }
    return names;
}

static int layout_traverse(PyObject *self, visitproc visit, void *arg)
{
    struct message_layout *layout = (struct message_layout *)self;
    Py_VISIT((PyObject *)layout->codec);
    Py_VISIT(layout->outline);
    Py_VISIT(layout->fields);
    Py_VISIT(layout->python);
    return 0;
}

/* There is no tp_clear: a cycle through a layout also passes through the dict of its fields. */
static void layout_dealloc(PyObject *self)
{
    struct message_layout *layout = (struct message_layout *)self;
    PyObject_GC_UnTrack(self);
    Py_XDECREF((PyObject *)layout->codec);
    Py_XDECREF(layout->outline);
    Py_XDECREF(layout->fields);
    Py_XDECREF(layout->python);
    Py_TYPE(self)->tp_free(self);
}

static PyMethodDef layout_methods[] = {
    {"write", (PyCFunction)(void (*)(void))layout_write, METH_VARARGS | METH_KEYWORDS,
     PyDoc_STR("write($self, /, buffer, offset=0)\n--\n\n"
               "Write everything except the elements of the loaned arrays, and return the message.")},
    {NULL, NULL, 0, NULL},
};

static PyMemberDef layout_members[] = {
    {"size", T_PYSSIZET, offsetof(struct message_layout, size), READONLY,
     PyDoc_STR("Size of the encoding in bytes.")},
    {NULL, 0, 0, 0, NULL},
};

static PyGetSetDef layout_properties[] = {
    {"loaned", layout_loaned, NULL, PyDoc_STR("The fields whose elements are filled later."), NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyTypeObject layout_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.MessageLayout",
    .tp_doc = "The layout of a message before some of its arrays have contents.",
    .tp_basicsize = sizeof(struct message_layout),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_DISALLOW_INSTANTIATION,
    .tp_traverse = layout_traverse,
    .tp_dealloc = layout_dealloc,
    .tp_methods = layout_methods,
    .tp_members = layout_members,
    .tp_getset = layout_properties,
};

int add_message_layout_type(PyObject *Py_UNUSED(module))
{
    return PyType_Ready(&layout_type);
}
