/* Messages as C sees them: what messages/codec does in Python, done from a table of the fields of each message
 * class. Whatever is uncommon or wrong is left to Python, which also words the errors. */
#ifndef ROBBIE_MESSAGE_CODEC_H
#define ROBBIE_MESSAGE_CODEC_H

#include "native.h"
#include "numpy_arrays.h"

struct message_codec;

/* The kinds of field types in field_types.py, numbered as in codec/table.py. */
enum field_kind { KIND_PRIMITIVE, KIND_TEXT, KIND_NESTED, KIND_NUMBERS, KIND_ITEMS };

struct message_field {
    PyObject *name;    /* interned */
    PyObject *initial; /* its value if the constructor gets none */
    Py_ssize_t slot;   /* where a message has the value: an offset in bytes */
    enum field_kind kind;
    char code;             /* of the primitive or the element, as in Python's struct; 0: it has none */
    size_t size;           /* of the same: size and alignment in bytes */
    Py_ssize_t length;     /* exactly this number of elements; -1: a sequence */
    Py_ssize_t max_length; /* most elements, or bytes of a text; -1: any */
    Py_ssize_t max_text;   /* most bytes of a text that is an element; -1: any */
    size_t smallest_item;  /* bytes that an element of a list takes at least */
    PyObject *dtype;       /* of an array */
    PyObject *empty;       /* its natural default: no elements, or zeros; all messages share it */
    struct message_codec *inner; /* of the nested message, or of a list's elements; NULL: these are strings */
};

struct message_codec {
    PyObject_HEAD
    PyTypeObject *message_type;
    PyObject *describe;  /* called once: returns the fields of the class */
    PyObject *make; /* called with the name of a function: returns it, in Python */
    PyObject *python[5]; /* these functions, as far as they were needed */
    bool is_installed[5]; /* whether the class has ours, and none of its own */
    bool is_described;
    Py_ssize_t fixed_size; /* of every encoding; 0: it depends on the message */
    bool is_unsuitable; /* numpy is of an unknown version: everything is left to Python */
    Py_ssize_t count;
    struct message_field *fields;
};

/* The functions of a message class that Python has too. */
enum message_function { FUNCTION_NEW, FUNCTION_SIZE, FUNCTION_ENCODE, FUNCTION_DECODE, FUNCTION_FORGET };

/* The function in Python, borrowed; NULL with an exception set. */
PyObject *codec_python(struct message_codec *codec, enum message_function function);

extern PyMethodDef codec_methods[];

/* The codec that `object` is, borrowed; NULL without an exception if it is none. */
struct message_codec *codec_from(PyObject *object);

/* The codec of a message class, borrowed; NULL without an exception if the class has none. */
struct message_codec *codec_of(PyTypeObject *message_type);

/* Make the table of fields if this has not been done; 0, 1: the codec is of no use, or -1 with an exception. */
int codec_describe(struct message_codec *codec);

/* All of these answer NULL or -1 *without an exception* for what they leave to Python. After an exception (out
 * of memory) nothing is left to do but to pass it on. */

/* The message with the fields given as keyword arguments. */
PyObject *codec_construct(struct message_codec *codec, PyObject *const *values, PyObject *names);

/* A value for another message of the class: a list is copied. NULL with an exception set if memory is full. */
PyObject *codec_share(const struct message_field *field, PyObject *value);

/* Replace the arrays of a message by the defaults of their types; false: left to Python. */
bool codec_forget_arrays(struct message_codec *codec, PyObject *message);

/* Bytes of the encoding, with the 4 bytes of the encapsulation. */
Py_ssize_t codec_size(struct message_codec *codec, PyObject *message);

/* Encode a message into `room` bytes; returns how many it takes. The bytes may be half written if it is left
 * to Python. */
Py_ssize_t codec_encode(struct message_codec *codec, PyObject *message, uint8_t *to, Py_ssize_t room);

/* Messages of which some arrays are filled later: in their outline these are ints, the number of elements. */

/* The outline from a dict of fields; those whose value is such an int are loaned. */
PyObject *codec_outline(struct message_codec *codec, PyObject *fields);

Py_ssize_t codec_outline_size(struct message_codec *codec, PyObject *outline);

/* Encode an outline; returns the message, whose loaned arrays are writable views and keep `pin` alive. */
PyObject *codec_encode_outline(struct message_codec *codec, PyObject *outline, uint8_t *to, Py_ssize_t room,
                               PyObject *pin);

/* Decode a message. Its arrays are views of `data`; each that has elements keeps `pin` alive, and so do the
 * views made of it. They are read-only unless `writable`; `pin` should have a buffer that says the same. */
PyObject *codec_decode(struct message_codec *codec, const uint8_t *data, Py_ssize_t size, PyObject *pin,
                       bool writable);

/* The same, but keeps `buffer`, from which `data` was got, alive by its buffer, and only if there is an array. */
PyObject *codec_decode_from(struct message_codec *codec, const uint8_t *data, Py_ssize_t size,
                            PyObject *buffer, bool writable);

/* The layout of a message with these fields, a dict; `python` makes it of class and fields if C cannot write it. */
PyObject *lay_out(struct message_codec *codec, PyObject *fields, PyObject *python);

/* Get a writable buffer of bytes, and from which byte on it is used; false: left to Python. */
bool get_room(Py_buffer *view, PyObject *buffer, PyObject *offset, Py_ssize_t *start);

static inline PyObject **slot_of(PyObject *message, const struct message_field *field)
{
    return (PyObject **)((char *)message + field->slot);
}

/* Whether a field of an outline is loaned. */
static inline bool is_loan(const struct message_field *field, PyObject *value)
{
    return field->kind == KIND_NUMBERS && PyLong_CheckExact(value);
}

/* Number of elements that are loaned; `codec_outline` checked it. */
static inline size_t loaned_count(PyObject *value)
{
    return PyLong_AsSize_t(value);
}

/* Bytes to skip from a position, counted from the encapsulation, to one aligned to a power of two. */
static inline size_t padding(size_t position, size_t alignment)
{
    return (4 - position) & (alignment - 1);
}

/* Whether an error is left to Python, which will find and word it; it is cleared then. */
static inline void leave_to_python(void)
{
    if (PyErr_Occurred() && !PyErr_ExceptionMatches(PyExc_MemoryError))
        PyErr_Clear();
}

#endif
