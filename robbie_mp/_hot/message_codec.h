/* Messages as C sees them: what codec/generate.py generates for each message class, done from a table of its
 * fields. Whatever is uncommon or wrong is left to the generated Python, which also words the errors. */
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
    PyObject *empty;       /* an array without elements, which all messages share */
    struct message_codec *inner; /* of the nested message, or of a list's elements; NULL: these are strings */
};

struct message_codec {
    PyObject_HEAD
    PyTypeObject *message_type;
    PyObject *describe;  /* called once: returns the fields of the class */
    PyObject *generated; /* called with the name of a function: returns it, generated in Python */
    PyObject *python[4]; /* these functions, as far as they were needed */
    bool is_described;
    bool is_unsuitable; /* numpy is of an unknown version: everything is left to Python */
    Py_ssize_t count;
    struct message_field *fields;
};

/* The functions of a message class that the generated Python has too. */
enum message_function { FUNCTION_NEW, FUNCTION_SIZE, FUNCTION_ENCODE, FUNCTION_DECODE };

/* The generated function, borrowed; NULL with an exception set. */
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

/* Bytes of the encoding, with the 4 bytes of the encapsulation. */
Py_ssize_t codec_size(struct message_codec *codec, PyObject *message);

/* Encode a message into `room` bytes; returns how many it takes. The bytes may be half written if it is left
 * to Python. */
Py_ssize_t codec_encode(struct message_codec *codec, PyObject *message, uint8_t *to, Py_ssize_t room);

/* The same without the elements of the arrays whose names are in the frozenset `loaned`: for each of them,
 * `loans` (a dict) gets a writable view of where the elements belong, which keeps `pin` alive. */
Py_ssize_t codec_encode_around(struct message_codec *codec, PyObject *message, uint8_t *to, Py_ssize_t room,
                               PyObject *loaned, PyObject *loans, PyObject *pin);

/* Decode a message. Its arrays are views of `data`; each that has elements keeps `pin` alive, and so do the
 * views made of it. They are read-only unless `writable`; `pin` should have a buffer that says the same. */
PyObject *codec_decode(struct message_codec *codec, const uint8_t *data, Py_ssize_t size, PyObject *pin,
                       bool writable);

/* The same, but keeps `buffer`, from which `data` was got, alive by its buffer, and only if there is an array. */
PyObject *codec_decode_from(struct message_codec *codec, const uint8_t *data, Py_ssize_t size,
                            PyObject *buffer, bool writable);

/* An object with the buffer of `buffer`: whoever keeps it keeps `buffer` itself, not only what that refers to. */
PyObject *pinned_buffer(PyObject *buffer, int flags);
int ready_pinned_buffer(void);

static inline PyObject **slot_of(PyObject *message, const struct message_field *field)
{
    return (PyObject **)((char *)message + field->slot);
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
