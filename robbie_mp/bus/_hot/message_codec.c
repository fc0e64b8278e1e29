/* The codec of a message class: the table of its fields, made at its first use. */
#include "message_codec.h"
#include "layout.h"
#include <structmember.h>

static PyObject *codec_name; /* "_codec", interned */

static const char *const FUNCTION_NAMES[] = {"__new__", "encoded_size", "encode_into", "decode", "forget_arrays"};

static PyTypeObject codec_type;

struct message_codec *codec_from(PyObject *object)
{
    return Py_IS_TYPE(object, &codec_type) ? (struct message_codec *)object : NULL;
}

struct message_codec *codec_of(PyTypeObject *message_type)
{
    PyObject *found = PyDict_GetItemWithError(message_type->tp_dict, codec_name);
    return found == NULL ? NULL : codec_from(found);
}

/* Where a message has its slot `name`; -1 with an exception set. */
static Py_ssize_t find_slot(PyTypeObject *message_type, PyObject *name)
{
    PyObject *descriptor = PyObject_GetAttr((PyObject *)message_type, name);
    if (descriptor == NULL)
        return -1;
    Py_ssize_t offset = -1;
    if (Py_IS_TYPE(descriptor, &PyMemberDescr_Type)) {
        PyMemberDef *member = ((PyMemberDescrObject *)descriptor)->d_member;
        if (member->type == T_OBJECT_EX && member->offset > 0 &&
            member->offset + (Py_ssize_t)sizeof(PyObject *) <= message_type->tp_basicsize)
            offset = member->offset;
    }
    Py_DECREF(descriptor);
    if (offset < 0)
        PyErr_Format(PyExc_TypeError, "%s.%U is no slot", message_type->tp_name, name);
    return offset;
}

/* Set `inner` to the codec of a message class, or to NULL if given None. */
static int find_inner(struct message_codec **inner, PyObject *message_type)
{
    if (message_type == Py_None)
        return 0;
    if (!PyType_Check(message_type)) {
        PyErr_SetString(PyExc_TypeError, "the class of a nested message is expected");
        return -1;
    }
    struct message_codec *found = codec_of((PyTypeObject *)message_type);
    if (found == NULL) {
        PyErr_SetString(PyExc_TypeError, "the class of the nested message has no codec");
        return -1;
    }
    int result = codec_describe(found);
    if (result == 0)
        *inner = (struct message_codec *)Py_NewRef((PyObject *)found);
    return result;
}

static bool is_sound(const struct message_field *field)
{
    bool has_element = field->kind == KIND_PRIMITIVE || field->kind == KIND_NUMBERS;
    if (field->kind < KIND_PRIMITIVE || field->kind > KIND_ITEMS)
        return false;
    if (has_element && field->size != 1 && field->size != 2 && field->size != 4 && field->size != 8)
        return false;
    return (field->kind != KIND_NESTED || field->inner != NULL) &&
           (field->kind != KIND_ITEMS || (field->smallest_item > 0 && PyList_CheckExact(field->initial)));
}

/* Read one field as codec/table.py describes it; 0, 1: unsuitable, or -1 with an exception set. */
static int read_field(struct message_field *field, PyTypeObject *message_type, PyObject *description)
{
    PyObject *name, *initial, *dtype, *empty, *inner;
    int kind, code;
    Py_ssize_t size, smallest_item;
    if (!PyArg_ParseTuple(description, "UOiCnnnnnOOO;a field", &name, &initial, &kind, &code, &size,
                          &field->length, &field->max_length, &field->max_text, &smallest_item, &dtype,
                          &empty, &inner))
        return -1;
    field->kind = (enum field_kind)kind;
    field->code = (char)code;
    field->size = (size_t)size;
    field->smallest_item = (size_t)smallest_item;
    field->initial = Py_NewRef(initial);
    field->dtype = Py_NewRef(dtype);
    field->empty = Py_NewRef(empty);
    field->name = Py_NewRef(name);
    PyUnicode_InternInPlace(&field->name);
    field->slot = find_slot(message_type, field->name);
    if (field->slot < 0)
        return -1;
    int result = find_inner(&field->inner, inner);
    if (result != 0)
        return result;
    if (field->kind == KIND_NUMBERS && (result = find_numpy()) != 0)
        return result;
    if (!is_sound(field)) {
        PyErr_Format(PyExc_ValueError, "%s.%U is described badly", message_type->tp_name, field->name);
        return -1;
    }
    return 0;
}

static void free_fields(struct message_field *fields, Py_ssize_t count)
{
    for (struct message_field *field = fields; field < fields + count; field++) {
        Py_XDECREF(field->name);
        Py_XDECREF(field->initial);
        Py_XDECREF(field->dtype);
        Py_XDECREF(field->empty);
        Py_XDECREF((PyObject *)field->inner);
    }
    PyMem_Free(fields);
}

static int read_fields(struct message_field *fields, PyTypeObject *message_type, PyObject *descriptions)
{
    int result = 0;
    for (Py_ssize_t index = 0; result == 0 && index < PyTuple_GET_SIZE(descriptions); index++)
        result = read_field(&fields[index], message_type, PyTuple_GET_ITEM(descriptions, index));
    return result;
}

static bool has_fixed_size(const struct message_codec *codec)
{
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        bool is_fixed = field->kind == KIND_PRIMITIVE || (field->kind == KIND_NUMBERS && field->length >= 0) ||
                        (field->kind == KIND_NESTED && field->inner->fixed_size > 0);
        if (!is_fixed)
            return false;
    }
    return true;
}

/* Measure a message of which no part needs to be looked at. */
static void measure_fixed(size_t *at, struct message_codec *codec)
{
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++)
        if (field->kind == KIND_NESTED)
            measure_fixed(at, field->inner);
        else
            *at += padding(*at, field->size) + field->size * (field->length < 0 ? 1 : (size_t)field->length);
    *at += codec->count == 0; /* the filler */
}

static Py_ssize_t codec_fixed_size(struct message_codec *codec)
{
    size_t at = LEAD_BYTES;
    measure_fixed(&at, codec);
    return (Py_ssize_t)at;
}

static int use_descriptions(struct message_codec *codec, PyObject *descriptions)
{
    if (!PyTuple_CheckExact(descriptions)) {
        PyErr_SetString(PyExc_TypeError, "the fields are expected as a tuple");
        return -1;
    }
    Py_ssize_t count = PyTuple_GET_SIZE(descriptions);
    struct message_field *fields = PyMem_Calloc((size_t)count + 1, sizeof(struct message_field));
    if (fields == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    int result = read_fields(fields, codec->message_type, descriptions);
    if (result != 0 || codec->is_described) { /* another thread may have done it meanwhile */
        free_fields(fields, count);
        return result;
    }
    codec->fields = fields;
    codec->count = count;
    codec->fixed_size = has_fixed_size(codec) ? codec_fixed_size(codec) : 0;
    codec->is_described = true;
    return 0;
}

static int describe(struct message_codec *codec)
{
    if (codec->describe == NULL) {
        PyErr_SetString(PyExc_RuntimeError, "the message class is being deleted");
        return -1;
    }
    PyObject *descriptions = PyObject_CallNoArgs(codec->describe);
    if (descriptions == NULL)
        return -1;
    int result = use_descriptions(codec, descriptions);
    Py_DECREF(descriptions);
    codec->is_unsuitable = result == 1;
    return result;
}

int codec_describe(struct message_codec *codec)
{
    if (codec->is_described)
        return 0;
    return codec->is_unsuitable ? 1 : describe(codec);
}

PyObject *codec_python(struct message_codec *codec, enum message_function function)
{
    if (codec->python[function] == NULL) {
        if (codec->make == NULL) {
            PyErr_SetString(PyExc_RuntimeError, "the message class is being deleted");
            return NULL;
        }
        codec->python[function] = PyObject_CallFunction(codec->make, "s", FUNCTION_NAMES[function]);
    }
    return codec->python[function];
}

/* The Python type. */

static PyObject *codec_new(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    PyObject *message_type, *describe_, *make;
    static char *names[] = {"message_type", "describe", "make", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "O!OO", names, &PyType_Type, &message_type,
                                     &describe_, &make))
        return NULL;
    struct message_codec *codec = (struct message_codec *)type->tp_alloc(type, 0);
    if (codec == NULL)
        return NULL;
    codec->message_type = (PyTypeObject *)Py_NewRef(message_type);
    codec->describe = Py_NewRef(describe_);
    codec->make = Py_NewRef(make);
    return (PyObject *)codec;
}

static int codec_traverse(PyObject *self, visitproc visit, void *arg)
{
    struct message_codec *codec = (struct message_codec *)self;
    Py_VISIT(codec->message_type);
    Py_VISIT(codec->describe);
    Py_VISIT(codec->make);
    for (size_t index = 0; index < Py_ARRAY_LENGTH(codec->python); index++)
        Py_VISIT(codec->python[index]);
    for (struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        Py_VISIT(field->initial);
        Py_VISIT(field->dtype);
        Py_VISIT(field->empty);
        Py_VISIT((PyObject *)field->inner);
    }
    return 0;
}

static int codec_clear(PyObject *self)
{
    struct message_codec *codec = (struct message_codec *)self;
    struct message_field *fields = codec->fields;
    Py_ssize_t count = codec->count;
    codec->fields = NULL;
    codec->count = 0;
    codec->is_described = false;
    free_fields(fields, count);
    Py_CLEAR(codec->describe);
    Py_CLEAR(codec->make);
    for (size_t index = 0; index < Py_ARRAY_LENGTH(codec->python); index++)
        Py_CLEAR(codec->python[index]);
    Py_CLEAR(codec->message_type);
    return 0;
}

static void codec_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    codec_clear(self);
    Py_TYPE(self)->tp_free(self);
}

bool get_room(Py_buffer *view, PyObject *buffer, PyObject *offset, Py_ssize_t *start)
{
    *start = 0;
    if (offset != NULL) {
        if (!PyLong_CheckExact(offset))
            return false;
        *start = PyLong_AsSsize_t(offset);
    }
    if (*start < 0 || PyObject_GetBuffer(buffer, view, PyBUF_CONTIG | PyBUF_FORMAT) != 0) {
        leave_to_python();
        return false;
    }
    bool is_bytes = view->ndim == 1 && (view->format == NULL || (view->format[0] == 'B' && !view->format[1]));
    if (is_bytes && *start <= view->len)
        return true;
    PyBuffer_Release(view);
    return false;
}

static PyTypeObject codec_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.MessageCodec",
    .tp_doc = "Creates, encodes and decodes the messages of one class.",
    .tp_basicsize = sizeof(struct message_codec),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = codec_new,
    .tp_traverse = codec_traverse,
    .tp_clear = codec_clear,
    .tp_dealloc = codec_dealloc,
};

int add_message_types(PyObject *module)
{
    if (codec_name == NULL && (codec_name = PyUnicode_InternFromString("_codec")) == NULL)
        return -1;
    codec_type.tp_methods = codec_methods;
    return PyModule_AddType(module, &codec_type);
}
