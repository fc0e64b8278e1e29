# cython: language_level=3, binding=False, cdivision=True, auto_pickle=False
"""The hot path in C; what it does is described by the Python of the same names."""
cimport cython

cdef extern from *:
    """
    /* Cython compares lengths and what functions return for an error with numbers of other types. */
    #pragma GCC diagnostic ignored "-Wsign-compare"
    #ifndef ROBBIE_SOURCES
    #define ROBBIE_SOURCES "" /* a test build */
    #endif
    #define this_module() Py_XNewRef(__pyx_m)
    """
    const char *ROBBIE_SOURCES
    object this_module()

cdef extern from "layout.h":
    const unsigned int LAYOUT_VERSION_IN_C "LAYOUT_VERSION"

cdef extern from "fuse.h":
    int add_fuse_types(object module) except -1

cdef extern from "native.h":
    int add_message_types(object module) except -1
    int add_message_layout_type(object module) except -1

LAYOUT_VERSION = LAYOUT_VERSION_IN_C
SOURCES = ROBBIE_SOURCES.decode()
add_fuse_types(this_module())
add_message_types(this_module())
add_message_layout_type(this_module())

include "words.pxi"
include "ring.pxi"
include "wakeup.pxi"
include "lock.pxi"
include "endpoint.pxi"
include "blocks.pxi"
include "history.pxi"
include "pins.pxi"
include "publisher.pxi"
include "subscriber.pxi"
include "books.pxi"
include "loop.pxi"
