/* What a message class gets from its codec: its call, its methods, and Python for all that C leaves to it. */
#include "message_codec.h"
#include <stddef.h>
#include <string.h>

/* The codec of a message, borrowed; NULL with an exception set. */
static struct message_codec *codec_of_message(PyObject *message)
{
    struct message_codec *codec = codec_of(Py_TYPE(message));
    if (codec == NULL && !PyErr_Occurred())
        PyErr_Format(PyExc_TypeError, "%s has no codec", Py_TYPE(message)->tp_name);
    return codec;
}

/* Call a function in Python with `self` before the arguments; `values` as in a vectorcall. */
static PyObject *call_python(struct message_codec *codec, enum message_function function, PyObject *self,
                             PyObject *const *values, Py_ssize_t count, PyObject *names)
{
    PyObject *few[8], **all = few, *callable = codec_python(codec, function);
    Py_ssize_t total = count + (names == NULL ? 0 : PyTuple_GET_SIZE(names));
    if (callable == NULL)
        return NULL;
    if (total + 1 > (Py_ssize_t)Py_ARRAY_LENGTH(few)) {
        all = PyMem_New(PyObject *, total + 1);
        if (all == NULL)
            return PyErr_NoMemory();
    }
    all[0] = self;
    for (Py_ssize_t index = 0; index < total; index++)
        all[index + 1] = values[index];
    PyObject *result = PyObject_Vectorcall(callable, all, (size_t)count + 1, names);
    if (all != few)
        PyMem_Free(all);
    return result;
}

/* Call the class as every class is called. */
static PyObject *call_type(PyObject *type, PyObject *const *values, Py_ssize_t count, PyObject *names)
{
    PyObject *result = NULL, *keywords = NULL, *arguments = PyTuple_New(count);
    if (arguments == NULL)
        return NULL;
    for (Py_ssize_t index = 0; index < count; index++)
        PyTuple_SET_ITEM(arguments, index, Py_NewRef(values[index]));
    if (names == NULL || (keywords = PyDict_New()) != NULL) {
        int failed = 0;
        for (Py_ssize_t index = 0; names != NULL && !failed && index < PyTuple_GET_SIZE(names); index++)
            failed = PyDict_SetItem(keywords, PyTuple_GET_ITEM(names, index), values[count + index]);
        if (!failed)
            result = PyType_Type.tp_call(type, arguments, keywords);
    }
    Py_XDECREF(keywords);
    Py_DECREF(arguments);
    return result;
}

/* Call a message class; it becomes the class's tp_vectorcall. */
static PyObject *call_message_type(PyObject *type, PyObject *const *values, size_t flags, PyObject *names)
{
    Py_ssize_t count = PyVectorcall_NARGS(flags);
    struct message_codec *codec = codec_of((PyTypeObject *)type);
    if (codec == NULL && PyErr_Occurred())
        return NULL;
    if (codec == NULL || ((PyTypeObject *)type)->tp_init != PyBaseObject_Type.tp_init)
        return call_type(type, values, count, names);
    if (count == 0) {
        PyObject *message = codec_construct(codec, values, names);
        if (message != NULL || PyErr_Occurred())
            return message;
    }
    return call_python(codec, FUNCTION_NEW, type, values, count, names);
}

static PyObject *message_encoded_size(PyObject *self, PyObject *Py_UNUSED(nothing))
{
    struct message_codec *codec = codec_of_message(self);
    if (codec == NULL)
        return NULL;
    Py_ssize_t size = codec_size(codec, self);
    if (size >= 0)
        return PyLong_FromSsize_t(size);
    return PyErr_Occurred() ? NULL : call_python(codec, FUNCTION_SIZE, self, NULL, 0, NULL);
}

static PyObject *message_encode_into(PyObject *self, PyObject *const *values, Py_ssize_t count)
{
    struct message_codec *codec = codec_of_message(self);
    if (codec == NULL)
        return NULL;
    Py_buffer view;
    Py_ssize_t start;
    if ((count == 1 || count == 2) && get_room(&view, values[0], count == 2 ? values[1] : NULL, &start)) {
        Py_ssize_t size = codec_encode(codec, self, (uint8_t *)view.buf + start, view.len - start);
        PyBuffer_Release(&view);
        if (size >= 0)
            return PyLong_FromSsize_t(size);
    }
    return PyErr_Occurred() ? NULL : call_python(codec, FUNCTION_ENCODE, self, values, count, NULL);
}

static PyObject *message_forget_arrays(PyObject *self, PyObject *Py_UNUSED(nothing))
{
    struct message_codec *codec = codec_of_message(self);
    if (codec == NULL)
        return NULL;
    if (codec_forget_arrays(codec, self))
        Py_RETURN_NONE;
    return PyErr_Occurred() ? NULL : call_python(codec, FUNCTION_FORGET, self, NULL, 0, NULL);
}

static PyObject *decode_from(PyObject *self, PyObject *buffer)
{
    struct message_codec *codec = (struct message_codec *)self;
    Py_buffer view;
    if (PyObject_GetBuffer(buffer, &view, PyBUF_SIMPLE) == 0) {
        PyObject *message = codec_decode_from(codec, view.buf, view.len, buffer, !view.readonly);
        PyBuffer_Release(&view);
        if (message != NULL || PyErr_Occurred())
            return message;
    } else
        leave_to_python();
    PyObject *decode = PyErr_Occurred() ? NULL : codec_python(codec, FUNCTION_DECODE);
    return decode == NULL ? NULL : PyObject_CallOneArg(decode, buffer);
}

PyDoc_STRVAR(encoded_size_doc, "encoded_size($self, /)\n--\n\n"
                               "Return the size of the encoding in bytes, with the 4 bytes of the "
                               "encapsulation header.");
PyDoc_STRVAR(encode_into_doc, "encode_into($self, buffer, offset=0, /)\n--\n\n"
                              "Write the encoding (XCDR1, little endian) into a buffer, and return its size.");
PyDoc_STRVAR(decode_doc, "decode($self, buffer, /)\n--\n\n"
                         "Decode a message; its arrays are views of the buffer.");

PyDoc_STRVAR(forget_arrays_doc, "forget_arrays($self, /)\n--\n\n"
                                "Replace the message's arrays (not those of nested messages) by their defaults.");

static PyMethodDef message_methods[] = {
    {"encoded_size", message_encoded_size, METH_NOARGS, encoded_size_doc},
    {"encode_into", (PyCFunction)(void (*)(void))message_encode_into, METH_FASTCALL, encode_into_doc},
    {"forget_arrays", message_forget_arrays, METH_NOARGS, forget_arrays_doc},
};

static int install_method(PyObject *message_type, PyMethodDef *method)
{
    PyObject *descriptor = PyDescr_NewMethod((PyTypeObject *)message_type, method);
    if (descriptor == NULL)
        return -1;
    int result = PyObject_SetAttrString(message_type, method->ml_name, descriptor);
    Py_DECREF(descriptor);
    return result;
}

static int install_decode(PyObject *self, PyObject *message_type)
{
    PyObject *decode = PyObject_GetAttrString(self, "decode");
    if (decode == NULL)
        return -1;
    int result = PyObject_SetAttrString(message_type, "decode", decode);
    Py_DECREF(decode);
    return result;
}

/* Let calls of the class create messages here, if calling it means what it means for every class. */
static void install_call(PyTypeObject *message_type)
{
    PyTypeObject *metaclass = Py_TYPE(message_type);
    if (metaclass->tp_call != PyType_Type.tp_call ||
        metaclass->tp_vectorcall_offset != offsetof(PyTypeObject, tp_vectorcall))
        return;
#if PY_VERSION_HEX < 0x030C0000
    metaclass->tp_flags |= Py_TPFLAGS_HAVE_VECTORCALL; /* later Pythons let every metaclass inherit it */
#endif
    message_type->tp_vectorcall = call_message_type;
}

static int install(PyObject *self, PyObject *message_type, const char *name)
{
    static const char *const names[] = {"__new__", "encoded_size", "encode_into", "decode"};
    for (size_t index = 0; index < Py_ARRAY_LENGTH(names); index++)
        if (strcmp(name, names[index]) == 0)
            ((struct message_codec *)self)->is_installed[index] = true;
    if (strcmp(name, "__new__") == 0) {
        install_call((PyTypeObject *)message_type);
        return 0;
    }
    if (strcmp(name, "decode") == 0)
        return install_decode(self, message_type);
    for (size_t index = 0; index < Py_ARRAY_LENGTH(message_methods); index++)
        if (strcmp(name, message_methods[index].ml_name) == 0)
            return install_method(message_type, &message_methods[index]);
    PyErr_Format(PyExc_ValueError, "there is no function %s", name);
    return -1;
}

static PyObject *codec_install(PyObject *self, PyObject *name)
{
    PyObject *message_type = (PyObject *)((struct message_codec *)self)->message_type;
    const char *text = PyUnicode_Check(name) ? PyUnicode_AsUTF8(name) : "";
    if (message_type == NULL || text == NULL)
        return NULL;
    if (PyObject_SetAttrString(message_type, "_codec", self) != 0 || install(self, message_type, text) != 0)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *codec_lay_out(PyObject *self, PyObject *const *values, Py_ssize_t count)
{
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "lay_out takes the fields and Python's function");
        return NULL;
    }
    PyObject *layout = lay_out((struct message_codec *)self, values[0], values[1]);
    if (layout == NULL && !PyErr_Occurred())
        Py_RETURN_NONE;
    return layout;
}

PyDoc_STRVAR(lay_out_doc, "lay_out($self, fields, python, /)\n--\n\n"
                          "Return the layout of a message with these fields; None if Python must make it.");
PyDoc_STRVAR(install_doc, "install($self, name, /)\n--\n\n"
                          "Give the class one of its functions: __new__, encoded_size, encode_into, decode"
                          " or forget_arrays.");

PyMethodDef codec_methods[] = {
    {"decode", decode_from, METH_O, decode_doc},
    {"lay_out", (PyCFunction)(void (*)(void))codec_lay_out, METH_FASTCALL, lay_out_doc},
    {"install", codec_install, METH_O, install_doc},
    {NULL, NULL, 0, NULL},
};
