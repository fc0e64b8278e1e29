/* What the files with Python bindings share. It comes first in them: Python.h, before any header of the C library,
 * chooses the POSIX that those headers show. */
#ifndef ROBBIE_NATIVE_H
#define ROBBIE_NATIVE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include "fuse.h"
#include "ring.h"
#include "words.h"

#if PY_VERSION_HEX < 0x030B0000 /* CPython 3.10 has these under other names */
static inline int PyFloat_Pack4(double number, char *to, int is_little_endian)
{
    return _PyFloat_Pack4(number, (unsigned char *)to, is_little_endian);
}

static inline double PyFloat_Unpack4(const char *from, int is_little_endian)
{
    return _PyFloat_Unpack4((const unsigned char *)from, is_little_endian);
}
#endif

/* Words that Python memory holds. As long as this is held, the memory cannot be unmapped: closing a mapping
 * (mmap.close) fails with BufferError while a buffer of it is in use. */
struct held_words {
    Py_buffer buffer;
    shared_word *words; /* NULL: nothing is held */
    Py_ssize_t count;
};

/* Hold the words of an object with a buffer of aligned 8-byte items; 0, or -1 with an exception set. */
int hold_words(struct held_words *held, PyObject *object, bool writable);
void release_words(struct held_words *held);

/* Set the exception for the use of what belongs to the process that forked this one; see linux/forks.py. */
void raise_forked_process(void);

/* Each adds its types and functions to the module; 0, or -1 with an exception set. */
int add_message_types(PyObject *module);
int add_message_layout_type(PyObject *module);

/* The types in Cython. What it makes defines them after it has included what uses them. */
struct block_object;
struct endpoint_object;
struct history_object;
struct kept_blocks_object;
struct lock_object;
struct mapped_segment_object;
struct message_bytes_object;
struct pins_object;
struct publisher_object;
struct subscriber_object;
struct unreferenced_object;

#include "endpoint.h"
#include "wakeup.h"
#include <pythread.h>
#include "native_made.h"

#endif
