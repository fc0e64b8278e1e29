/* Encodes messages, and measures the encoding; the same as codec/fields.py for messages
 * whose fields nobody has changed. All functions return -1, or false, for what is left to Python. */
#include "message_codec.h"
#include <string.h>

static const uint8_t CDR_LITTLE_ENDIAN[4] = {0, 1, 0, 0};

/* What is written, and where. */
struct writer {
    uint8_t *start;
    size_t at; /* counted from the encapsulation */
    size_t end;
    PyObject *pin;  /* what loaned arrays keep alive; NULL: none can be loaned */
    PyObject *made; /* the message with the loaned arrays */
};

/* Where the next `size` bytes belong, aligned, with zeros before them; NULL: they do not fit. */
static uint8_t *place(struct writer *writer, size_t alignment, size_t size)
{
    size_t gap = padding(writer->at, alignment), left = writer->end - writer->at;
    if (gap > left || size > left - gap)
        return NULL;
    uint8_t *to = writer->start + writer->at;
    memset(to, 0, gap);
    writer->at += gap + size;
    return to + gap;
}

static bool write_length(struct writer *writer, size_t length)
{
    uint32_t word = (uint32_t)length;
    uint8_t *to = place(writer, 4, 4);
    if (to == NULL || length > UINT32_MAX)
        return false;
    memcpy(to, &word, 4);
    return true;
}

static bool write_float(PyObject *value, char code, uint8_t *to)
{
    if (!PyFloat_CheckExact(value))
        return false;
    double number = PyFloat_AS_DOUBLE(value);
    if (code == 'f')
        return PyFloat_Pack4(number, (char *)to, 1) == 0;
    memcpy(to, &number, 8);
    return true;
}

/* Write the lowest bytes of an integer, which are the same whether it has a sign or not. */
static bool write_integer(PyObject *value, char code, size_t size, uint8_t *to)
{
    int overflow;
    if (!PyLong_CheckExact(value))
        return false;
    long long number = PyLong_AsLongLongAndOverflow(value, &overflow);
    unsigned long long bits = (unsigned long long)number;
    bool fits = overflow == 0;
    switch (code) {
    case 'b':
        fits = fits && INT8_MIN <= number && number <= INT8_MAX;
        break;
    case 'B':
        fits = fits && 0 <= number && number <= UINT8_MAX;
        break;
    case 'h':
        fits = fits && INT16_MIN <= number && number <= INT16_MAX;
        break;
    case 'H':
        fits = fits && 0 <= number && number <= UINT16_MAX;
        break;
    case 'i':
        fits = fits && INT32_MIN <= number && number <= INT32_MAX;
        break;
    case 'I':
        fits = fits && 0 <= number && number <= UINT32_MAX;
        break;
    case 'Q':
        if (overflow > 0) {
            bits = PyLong_AsUnsignedLongLong(value);
            fits = !PyErr_Occurred();
        } else
            fits = fits && number >= 0;
        break;
    default: /* q */
        break;
    }
    if (fits)
        memcpy(to, &bits, size);
    return fits;
}

static bool write_primitive(struct writer *writer, const struct message_field *field, PyObject *value)
{
    uint8_t *to = place(writer, field->size, field->size);
    if (to == NULL)
        return false;
    switch (field->code) {
    case 'd':
    case 'f':
        return write_float(value, field->code, to);
    case '?':
        *to = value == Py_True;
        return PyBool_Check(value);
    default:
        return write_integer(value, field->code, field->size, to);
    }
}

static bool write_text(struct writer *writer, PyObject *value)
{
    Py_ssize_t size;
    if (!PyUnicode_CheckExact(value))
        return false;
    const char *octets = PyUnicode_AsUTF8AndSize(value, &size);
    if (octets == NULL || !write_length(writer, (size_t)size + 1))
        return false;
    uint8_t *to = place(writer, 1, (size_t)size + 1);
    if (to == NULL)
        return false;
    memcpy(to, octets, (size_t)size);
    to[size] = 0;
    return true;
}

static bool write_numbers(struct writer *writer, const struct message_field *field, PyObject *value)
{
    struct numpy_array *array = array_of(value, field->dtype);
    if (array == NULL || !has_no_gaps(array, field->size))
        return false;
    size_t count = (size_t)array->dimensions[0];
    if (field->length >= 0) {
        if ((Py_ssize_t)count != field->length)
            return false;
    } else if (!write_length(writer, count))
        return false;
    if (count == 0)
        return true;
    uint8_t *to = place(writer, field->size, count * field->size);
    if (to == NULL)
        return false;
    memcpy(to, array->data, count * field->size);
    return true;
}

/* Write the length of an array that is filled later, and show its place in the message that is made. */
static bool write_loan(struct writer *writer, const struct message_field *field, size_t count)
{
    PyObject *view;
    if (!write_length(writer, count) || count > writer->end / field->size)
        return false;
    if (count == 0)
        view = PyObject_CallMethod(field->empty, "copy", NULL); /* writable like any loan */
    else {
        uint8_t *to = place(writer, field->size, count * field->size);
        if (to == NULL)
            return false;
        view = array_view(field->dtype, field->size, (Py_ssize_t)count, to, true, writer->pin);
    }
    *slot_of(writer->made, field) = view;
    return view != NULL;
}

static bool write_message(struct writer *writer, struct message_codec *codec, PyObject *message);

static bool write_items(struct writer *writer, const struct message_field *field, PyObject *value)
{
    if (!PyList_CheckExact(value))
        return false;
    if (field->length >= 0) {
        if (PyList_GET_SIZE(value) != field->length)
            return false;
    } else if (!write_length(writer, (size_t)PyList_GET_SIZE(value)))
        return false;
    for (Py_ssize_t index = 0; index < PyList_GET_SIZE(value); index++) {
        PyObject *item = PyList_GET_ITEM(value, index);
        if (!(field->inner != NULL ? write_message(writer, field->inner, item) : write_text(writer, item)))
            return false;
    }
    return true;
}

static bool write_field(struct writer *writer, const struct message_field *field, PyObject *value)
{
    switch (field->kind) {
    case KIND_PRIMITIVE:
        return write_primitive(writer, field, value);
    case KIND_TEXT:
        return write_text(writer, value);
    case KIND_NESTED:
        return write_message(writer, field->inner, value);
    case KIND_NUMBERS:
        return write_numbers(writer, field, value);
    case KIND_ITEMS:
        return write_items(writer, field, value);
    }
    return false;
}

static bool write_message(struct writer *writer, struct message_codec *codec, PyObject *message)
{
    if (!Py_IS_TYPE(message, codec->message_type))
        return false;
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject *value = *slot_of(message, field);
        if (value == NULL || !write_field(writer, field, value))
            return false;
    }
    if (codec->count > 0)
        return true;
    uint8_t *filler = place(writer, 1, 1);
    if (filler == NULL)
        return false;
    *filler = 0;
    return true;
}

static bool write_encapsulation(struct writer *writer)
{
    uint8_t *to = place(writer, 1, sizeof(CDR_LITTLE_ENDIAN));
    if (to != NULL)
        memcpy(to, CDR_LITTLE_ENDIAN, sizeof(CDR_LITTLE_ENDIAN));
    return to != NULL;
}

Py_ssize_t codec_encode(struct message_codec *codec, PyObject *message, uint8_t *to, Py_ssize_t room)
{
    struct writer writer = {.start = to, .end = (size_t)room};
    if (codec_describe(codec) != 0)
        return -1;
    if (write_encapsulation(&writer) && write_message(&writer, codec, message))
        return (Py_ssize_t)writer.at;
    leave_to_python();
    return -1;
}

static bool write_outline(struct writer *writer, struct message_codec *codec, PyObject *outline)
{
    if (!write_encapsulation(writer))
        return false;
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject *value = *slot_of(outline, field);
        if (is_loan(field, value)) {
            if (!write_loan(writer, field, loaned_count(value)))
                return false;
        } else if (!write_field(writer, field, value) ||
                   (*slot_of(writer->made, field) = codec_share(field, value)) == NULL)
            return false;
    }
    return true;
}

PyObject *codec_encode_outline(struct message_codec *codec, PyObject *outline, uint8_t *to, Py_ssize_t room,
                               PyObject *pin)
{
    PyObject *made = codec->message_type->tp_alloc(codec->message_type, 0);
    if (made == NULL)
        return NULL;
    struct writer writer = {to, 0, (size_t)room, pin, made};
    if (!write_outline(&writer, codec, outline)) {
        leave_to_python();
        Py_CLEAR(made);
    }
    return made;
}

/* Measuring: each function moves `at`, or returns false. */

static bool measure_message(size_t *at, struct message_codec *codec, PyObject *message);

static bool measure_text(size_t *at, PyObject *value)
{
    Py_ssize_t size;
    if (!PyUnicode_CheckExact(value) || PyUnicode_AsUTF8AndSize(value, &size) == NULL)
        return false;
    *at += padding(*at, 4) + 4 + (size_t)size + 1;
    return true;
}

static bool measure_numbers(size_t *at, const struct message_field *field, PyObject *value)
{
    size_t count = (size_t)field->length;
    if (field->length < 0) {
        /* Python's loans have a placeholder of this length instead of an array: Python measures them. */
        struct numpy_array *array = array_of(value, field->dtype);
        if (array == NULL)
            return false;
        count = (size_t)array->dimensions[0];
        *at += padding(*at, 4) + 4;
    }
    if (count > 0)
        *at += padding(*at, field->size) + count * field->size;
    return true;
}

static bool measure_items(size_t *at, const struct message_field *field, PyObject *value)
{
    if (!PyList_CheckExact(value))
        return false;
    if (field->length < 0)
        *at += padding(*at, 4) + 4;
    for (Py_ssize_t index = 0; index < PyList_GET_SIZE(value); index++) {
        PyObject *item = PyList_GET_ITEM(value, index);
        if (!(field->inner != NULL ? measure_message(at, field->inner, item) : measure_text(at, item)))
            return false;
    }
    return true;
}

static bool measure_field(size_t *at, const struct message_field *field, PyObject *value)
{
    switch (field->kind) {
    case KIND_PRIMITIVE:
        *at += padding(*at, field->size) + field->size;
        return true;
    case KIND_TEXT:
        return measure_text(at, value);
    case KIND_NESTED:
        return measure_message(at, field->inner, value);
    case KIND_NUMBERS:
        return measure_numbers(at, field, value);
    case KIND_ITEMS:
        return measure_items(at, field, value);
    }
    return false;
}

static bool measure_message(size_t *at, struct message_codec *codec, PyObject *message)
{
    if (!Py_IS_TYPE(message, codec->message_type))
        return false;
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject *value = *slot_of(message, field);
        if (value == NULL || !measure_field(at, field, value))
            return false;
    }
    *at += codec->count == 0; /* the filler */
    return true;
}

Py_ssize_t codec_size(struct message_codec *codec, PyObject *message)
{
    if (codec_describe(codec) != 0)
        return -1;
    if (codec->fixed_size > 0)
        return codec->fixed_size;
    size_t at = sizeof(CDR_LITTLE_ENDIAN);
    if (measure_message(&at, codec, message) && at <= PY_SSIZE_T_MAX)
        return (Py_ssize_t)at;
    leave_to_python();
    return -1;
}

Py_ssize_t codec_outline_size(struct message_codec *codec, PyObject *outline)
{
    size_t at = sizeof(CDR_LITTLE_ENDIAN);
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject *value = *slot_of(outline, field);
        if (is_loan(field, value)) {
            at += padding(at, 4) + 4;
            if (loaned_count(value) > 0)
                at += padding(at, field->size) + loaned_count(value) * field->size;
        } else if (!measure_field(&at, field, value))
            return -1;
    }
    return (Py_ssize_t)at;
}
