/* Decodes messages; the same as codec/fields.py. Whatever is wrong with the bytes is left to Python, which
 * finds the place and words the error. */
#include "message_codec.h"
#include <string.h>

enum { MAX_TRAILING_BYTES = 3 }; /* some writers pad a message to a multiple of four */

/* What is read, and how far. */
struct reader {
    const uint8_t *start;
    size_t at; /* counted from the encapsulation */
    size_t end;
    PyObject *pin;    /* what arrays keep alive; NULL: made at the first array ... */
    PyObject *buffer; /* ... of this object */
    bool is_writable;
};

/* The next `count` aligned elements of this size; NULL: there are fewer. */
static const uint8_t *take(struct reader *reader, size_t size, size_t count)
{
    size_t gap = padding(reader->at, size), left = reader->end - reader->at;
    if (gap > left || count > (left - gap) / size)
        return NULL;
    const uint8_t *from = reader->start + reader->at + gap;
    reader->at += gap + count * size;
    return from;
}

static bool read_length(struct reader *reader, uint32_t *length)
{
    const uint8_t *from = take(reader, 4, 1);
    if (from != NULL)
        memcpy(length, from, 4);
    return from != NULL;
}

/* Read the elements' number of a field that is an array or a list. */
static bool read_count(struct reader *reader, const struct message_field *field, size_t *count)
{
    uint32_t length;
    if (field->length >= 0) {
        *count = (size_t)field->length;
        return true;
    }
    if (!read_length(reader, &length))
        return false;
    *count = length;
    return field->max_length < 0 || length <= (size_t)field->max_length;
}

#define READ_AS(type, convert)                                                                               \
    do {                                                                                                     \
        type number;                                                                                         \
        memcpy(&number, from, sizeof(number));                                                               \
        return convert(number);                                                                              \
    } while (0)

static PyObject *read_primitive(struct reader *reader, const struct message_field *field)
{
    const uint8_t *from = take(reader, field->size, 1);
    if (from == NULL)
        return NULL;
    switch (field->code) {
    case '?':
        return PyBool_FromLong(*from != 0);
    case 'b':
        READ_AS(int8_t, PyLong_FromLong);
    case 'B':
        READ_AS(uint8_t, PyLong_FromLong);
    case 'h':
        READ_AS(int16_t, PyLong_FromLong);
    case 'H':
        READ_AS(uint16_t, PyLong_FromLong);
    case 'i':
        READ_AS(int32_t, PyLong_FromLong);
    case 'I':
        READ_AS(uint32_t, PyLong_FromUnsignedLong);
    case 'q':
        READ_AS(int64_t, PyLong_FromLongLong);
    case 'Q':
        READ_AS(uint64_t, PyLong_FromUnsignedLongLong);
    case 'f':
        return PyFloat_FromDouble(PyFloat_Unpack4((const char *)from, 1));
    case 'd':
        READ_AS(double, PyFloat_FromDouble);
    default:
        return NULL;
    }
}

static PyObject *read_text(struct reader *reader, Py_ssize_t max_length)
{
    uint32_t length;
    if (!read_length(reader, &length) || (max_length >= 0 && length > (size_t)max_length + 1))
        return NULL;
    if (length == 0)
        return PyUnicode_FromStringAndSize(NULL, 0); /* some writers leave the NUL of an empty string out */
    const uint8_t *from = take(reader, 1, length);
    if (from == NULL || from[length - 1] != 0)
        return NULL;
    return PyUnicode_DecodeUTF8((const char *)from, (Py_ssize_t)length - 1, NULL);
}

/* Whether all truth values are 0 or 1, as numpy needs them. */
static bool are_truths(const uint8_t *from, size_t count)
{
    uint8_t all = 0;
    for (size_t index = 0; index < count; index++)
        all |= from[index];
    return all <= 1;
}

static PyObject *read_numbers(struct reader *reader, const struct message_field *field)
{
    size_t count;
    if (!read_count(reader, field, &count))
        return NULL;
    if (count == 0)
        return Py_NewRef(field->empty);
    const uint8_t *from = take(reader, field->size, count);
    if (from == NULL || (field->code == '?' && !are_truths(from, count)))
        return NULL;
    if (reader->pin == NULL) {
        reader->pin = pinned_buffer(reader->buffer, PyBUF_SIMPLE);
        if (reader->pin == NULL)
            return NULL;
    }
    return array_view(field->dtype, field->size, (Py_ssize_t)count, from, reader->is_writable, reader->pin);
}

static PyObject *read_message(struct reader *reader, struct message_codec *codec);

static PyObject *read_items(struct reader *reader, const struct message_field *field)
{
    size_t count;
    if (!read_count(reader, field, &count) || count > (reader->end - reader->at) / field->smallest_item)
        return NULL;
    PyObject *items = PyList_New((Py_ssize_t)count);
    for (size_t index = 0; items != NULL && index < count; index++) {
        PyObject *item = field->inner != NULL ? read_message(reader, field->inner)
                                              : read_text(reader, field->max_text);
        if (item == NULL)
            Py_CLEAR(items);
        else
            PyList_SET_ITEM(items, (Py_ssize_t)index, item);
    }
    return items;
}

static PyObject *read_field(struct reader *reader, const struct message_field *field)
{
    switch (field->kind) {
    case KIND_PRIMITIVE:
        return read_primitive(reader, field);
    case KIND_TEXT:
        return read_text(reader, field->max_length);
    case KIND_NESTED:
        return read_message(reader, field->inner);
    case KIND_NUMBERS:
        return read_numbers(reader, field);
    case KIND_ITEMS:
        return read_items(reader, field);
    }
    return NULL;
}

static PyObject *read_message(struct reader *reader, struct message_codec *codec)
{
    if (codec->count == 0 && take(reader, 1, 1) == NULL) /* the filler */
        return NULL;
    PyObject *message = codec->message_type->tp_alloc(codec->message_type, 0);
    if (message == NULL)
        return NULL;
    for (const struct message_field *field = codec->fields; field < codec->fields + codec->count; field++) {
        PyObject *value = read_field(reader, field);
        if (value == NULL) {
            Py_DECREF(message);
            return NULL;
        }
        *slot_of(message, field) = value;
    }
    return message;
}

static PyObject *decode(struct message_codec *codec, struct reader *reader)
{
    if (codec_describe(codec) != 0)
        return NULL;
    const uint8_t *encapsulation = take(reader, 1, 4);
    PyObject *message = NULL;
    if (encapsulation != NULL && encapsulation[0] == 0 && encapsulation[1] == 1)
        message = read_message(reader, codec);
    if (message != NULL && reader->end - reader->at > MAX_TRAILING_BYTES)
        Py_CLEAR(message);
    if (message == NULL)
        leave_to_python();
    return message;
}

PyObject *codec_decode(struct message_codec *codec, const uint8_t *data, Py_ssize_t size, PyObject *pin,
                       bool writable)
{
    struct reader reader = {data, 0, (size_t)size, pin, NULL, writable};
    return decode(codec, &reader);
}

PyObject *codec_decode_from(struct message_codec *codec, const uint8_t *data, Py_ssize_t size,
                            PyObject *buffer, bool writable)
{
    struct reader reader = {data, 0, (size_t)size, NULL, buffer, writable};
    PyObject *message = decode(codec, &reader);
    Py_XDECREF(reader.pin);
    return message;
}
