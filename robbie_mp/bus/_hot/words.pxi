# What all bindings use: words of shared memory that they hold, and what C and Cython have in common.
from cpython.buffer cimport PyBUF_SIMPLE, PyBUF_WRITABLE, PyBuffer_Release, PyObject_GetBuffer
from cpython.exc cimport PyErr_Occurred, PyErr_SetFromErrno
from cpython.mem cimport PyMem_Calloc, PyMem_Free, PyMem_Realloc
from cpython.number cimport PyNumber_Index
from cpython.object cimport PyObject, PyObject_TypeCheck, PyTypeObject
from libc.errno cimport EINTR, ETIMEDOUT, errno
from libc.stdint cimport INT64_MAX, UINT64_MAX, int64_t, uint8_t, uint32_t, uint64_t
from libc.string cimport memset
from posix.time cimport CLOCK_MONOTONIC, clock_gettime, timespec

cdef extern from "words.h":
    ctypedef struct shared_word:
        pass
    uint64_t load(const shared_word *place)

cdef extern from "native.h":
    struct held_words:
        Py_buffer buffer
        shared_word *words
        Py_ssize_t count
    int hold_words(held_words *held, object memory, bint writable) except -1
    void release_words(held_words *held)
    void raise_forked_process() except *

cdef extern from *:
    """
    GUARDED(try_to_store, (shared_word *place, uint64_t value), store(place, value))
    """
    ctypedef bint c_bool "bool"
    int try_to_store(shared_word *place, uint64_t value) except -1


cdef uint64_t word(number) except? 0xFFFFFFFFFFFFFFFF:
    """Return a number that is an integer, which a mere conversion would make of one with a fraction."""
    return PyNumber_Index(number)
