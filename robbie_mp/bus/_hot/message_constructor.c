/* Creates a message from keyword arguments; the same as codec/constructor.py for common values. */
#include "message_codec.h"
#include <string.h>

/* Whether a value can be told to be a number in these limits without converting it. */
static bool is_integer_within(PyObject *value, long long low, long long high)
{
    int overflow;
    long long number = PyLong_AsLongLongAndOverflow(value, &overflow);
    return overflow == 0 && low <= number && number <= high;
}

static bool fits_integer(PyObject *value, char code)
{
    switch (code) {
    case 'b':
        return is_integer_within(value, INT8_MIN, INT8_MAX);
    case 'B':
        return is_integer_within(value, 0, UINT8_MAX);
    case 'h':
        return is_integer_within(value, INT16_MIN, INT16_MAX);
    case 'H':
        return is_integer_within(value, 0, UINT16_MAX);
    case 'i':
        return is_integer_within(value, INT32_MIN, INT32_MAX);
    case 'I':
        return is_integer_within(value, 0, UINT32_MAX);
    case 'q':
        return is_integer_within(value, INT64_MIN, INT64_MAX);
    case 'Q':
        if (is_integer_within(value, 0, INT64_MAX))
            return true;
        if (PyLong_AsUnsignedLongLong(value) == (unsigned long long)-1 && PyErr_Occurred()) {
            PyErr_Clear();
            return false;
        }
        return true;
    default:
        return false;
    }
}

/* The value as float32 holds it; NULL with an exception set if it is too large. */
static PyObject *rounded_to_float32(PyObject *value, double number)
{
    char packed[4];
    if (PyFloat_Pack4(number, packed, 1) != 0)
        return NULL;
    double rounded = PyFloat_Unpack4(packed, 1);
    if (rounded == number && PyFloat_CheckExact(value))
        return Py_NewRef(value);
    return PyFloat_FromDouble(rounded); /* also of a NaN, which equals nothing */
}

/* Whether a value is a real number: others also convert to a float, but may lose a part of themselves. */
static bool is_real(PyObject *value)
{
    const char *name = Py_TYPE(value)->tp_name;
    return PyFloat_Check(value) || PyLong_Check(value) || strcmp(name, "numpy.float32") == 0 ||
           strncmp(name, "numpy.int", 9) == 0 || strncmp(name, "numpy.uint", 10) == 0;
}

static PyObject *fit_float(PyObject *value, char code)
{
    if (!is_real(value))
        return NULL;
    double number = PyFloat_AsDouble(value);
    if (number == -1.0 && PyErr_Occurred())
        return NULL;
    if (code == 'f')
        return rounded_to_float32(value, number);
    return PyFloat_CheckExact(value) ? Py_NewRef(value) : PyFloat_FromDouble(number);
}

/* An integer that is exactly an `int`; NULL: Python has to look at the value. */
static PyObject *exact_integer(PyObject *value)
{
    if (PyLong_CheckExact(value))
        return Py_NewRef(value);
    if (PyLong_Check(value))
        return PyLong_Type.tp_as_number->nb_int(value);
    PyObject *number = is_real(value) && PyIndex_Check(value) ? PyNumber_Index(value) : NULL;
    if (number != NULL && !PyLong_CheckExact(number))
        Py_CLEAR(number);
    return number;
}

static PyObject *fit_primitive(const struct message_field *field, PyObject *value)
{
    if (field->code == 'd' || field->code == 'f')
        return fit_float(value, field->code);
    if (field->code == '?')
        return value == Py_True || value == Py_False ? Py_NewRef(value) : NULL;
    PyObject *number = exact_integer(value);
    if (number != NULL && !fits_integer(number, field->code))
        Py_CLEAR(number);
    return number;
}

static bool fits_text(PyObject *value, Py_ssize_t max_length)
{
    if (!PyUnicode_CheckExact(value))
        return false;
    Py_ssize_t size;
    const char *octets = PyUnicode_AsUTF8AndSize(value, &size);
    return octets != NULL && memchr(octets, 0, (size_t)size) == NULL && (max_length < 0 || size <= max_length);
}

static bool fits_array(const struct message_field *field, PyObject *value)
{
    struct numpy_array *array = array_of(value, field->dtype);
    if (array == NULL)
        return false;
    Py_ssize_t count = array->dimensions[0];
    if (field->length >= 0)
        return count == field->length;
    return (count == 0 || array->strides[0] == (Py_ssize_t)field->size) &&
           (field->max_length < 0 || count <= field->max_length);
}

/* A copy of a list whose elements fit. */
static PyObject *fit_items(const struct message_field *field, PyObject *value)
{
    if (!PyList_CheckExact(value))
        return NULL;
    PyObject *items = PyList_GetSlice(value, 0, PY_SSIZE_T_MAX);
    if (items == NULL)
        return NULL;
    Py_ssize_t count = PyList_GET_SIZE(items);
    bool fits = (field->length < 0 || count == field->length) &&
                (field->max_length < 0 || count <= field->max_length);
    for (Py_ssize_t index = 0; fits && index < count; index++) {
        PyObject *item = PyList_GET_ITEM(items, index);
        fits = field->inner != NULL ? Py_IS_TYPE(item, field->inner->message_type)
                                    : fits_text(item, field->max_text);
    }
    if (!fits)
        Py_CLEAR(items);
    return items;
}

static PyObject *fit(const struct message_field *field, PyObject *value)
{
    bool fits = false;
    switch (field->kind) {
    case KIND_PRIMITIVE:
        return fit_primitive(field, value);
    case KIND_ITEMS:
        return fit_items(field, value);
    case KIND_TEXT:
        fits = fits_text(value, field->max_length);
        break;
    case KIND_NESTED:
        fits = Py_IS_TYPE(value, field->inner->message_type);
        break;
    case KIND_NUMBERS:
        fits = fits_array(field, value);
        break;
    }
    return fits ? Py_NewRef(value) : NULL;
}

/* The field with a name, looked for from `start` on, since callers mostly keep the order; NULL: none has it. */
static struct message_field *field_named(struct message_codec *codec, PyObject *name, Py_ssize_t start)
{
    for (Py_ssize_t step = 0; step < codec->count; step++) {
        struct message_field *field = &codec->fields[(start + step) % codec->count];
        if (field->name == name)
            return field;
    }
    for (Py_ssize_t index = 0; index < codec->count; index++) /* a name that is not interned */
        if (PyUnicode_Check(name) && PyUnicode_Compare(codec->fields[index].name, name) == 0)
            return &codec->fields[index];
    return NULL;
}

static int set_given(struct message_codec *codec, PyObject *message, PyObject *const *values, PyObject *names)
{
    Py_ssize_t given = names == NULL ? 0 : PyTuple_GET_SIZE(names);
    Py_ssize_t start = 0;
    for (Py_ssize_t index = 0; index < given; index++) {
        struct message_field *field = field_named(codec, PyTuple_GET_ITEM(names, index), start);
        if (field == NULL || *slot_of(message, field) != NULL)
            return -1;
        PyObject *value = fit(field, values[index]);
        if (value == NULL)
            return -1;
        *slot_of(message, field) = value;
        start = field - codec->fields + 1;
    }
    return 0;
}

static int set_initial(struct message_codec *codec, PyObject *message)
{
    for (struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject **slot = slot_of(message, field);
        if (*slot != NULL)
            continue;
        PyObject *value =
            field->kind == KIND_ITEMS ? fit_items(field, field->initial) : Py_NewRef(field->initial);
        if (value == NULL)
            return -1;
        *slot = value;
    }
    return 0;
}

static PyObject *new_message(struct message_codec *codec)
{
    return codec->message_type->tp_alloc(codec->message_type, 0);
}

PyObject *codec_construct(struct message_codec *codec, PyObject *const *values, PyObject *names)
{
    if (codec_describe(codec) != 0)
        return NULL;
    PyObject *message = new_message(codec);
    if (message == NULL)
        return NULL;
    if (set_given(codec, message, values, names) != 0 || set_initial(codec, message) != 0) {
        leave_to_python();
        Py_CLEAR(message);
    }
    return message;
}

/* The number of elements to be loaned, if a value says one that the field can have; or NULL. */
static PyObject *fit_loan(const struct message_field *field, PyObject *value)
{
    Py_ssize_t limit = field->max_length >= 0 ? field->max_length : (Py_ssize_t)UINT32_MAX;
    bool fits = field->length < 0 && is_integer_within(value, 0, limit);
    return fits ? Py_NewRef(value) : NULL;
}

static int set_outline(struct message_codec *codec, PyObject *message, PyObject *fields)
{
    Py_ssize_t position = 0, start = 0;
    PyObject *name, *value;
    while (PyDict_Next(fields, &position, &name, &value)) {
        struct message_field *field = field_named(codec, name, start);
        if (field == NULL || *slot_of(message, field) != NULL)
            return -1;
        PyObject *given = Py_NewRef(value); /* a collection of garbage may change the dict */
        PyObject *fitted = is_loan(field, value) ? fit_loan(field, value) : fit(field, value);
        Py_DECREF(given);
        if (fitted == NULL)
            return -1;
        *slot_of(message, field) = fitted;
        start = field - codec->fields + 1;
    }
    return 0;
}

PyObject *codec_outline(struct message_codec *codec, PyObject *fields)
{
    if (codec_describe(codec) != 0 || !PyDict_CheckExact(fields))
        return NULL;
    PyObject *message = new_message(codec);
    if (message == NULL)
        return NULL;
    if (set_outline(codec, message, fields) != 0 || set_initial(codec, message) != 0) {
        leave_to_python();
        Py_CLEAR(message);
    }
    return message;
}

PyObject *codec_share(const struct message_field *field, PyObject *value)
{
    return field->kind == KIND_ITEMS ? PyList_GetSlice(value, 0, PY_SSIZE_T_MAX) : Py_NewRef(value);
}

bool codec_forget_arrays(struct message_codec *codec, PyObject *message)
{
    if (codec_describe(codec) != 0 || !Py_IS_TYPE(message, codec->message_type))
        return false;
    for (struct message_field *field = codec->fields; field < codec->fields + codec->count; field++)
        if (field->kind == KIND_NUMBERS)
            Py_XSETREF(*slot_of(message, field), Py_NewRef(field->empty));
    return true;
}
