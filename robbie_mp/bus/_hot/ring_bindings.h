/* The Python types of the rings' ends, for other bindings that work on the same ends. */
#ifndef ROBBIE_RING_BINDINGS_H
#define ROBBIE_RING_BINDINGS_H

#include "native.h"

/* The writing end of a ring of records or of numbers. */
struct ring_writer_object {
    PyObject_HEAD
    struct held_words words;
    struct held_words tail_words;
    struct ring_writer ring;
    bool is_disowned;
};

/* The reading end. */
struct ring_reader_object {
    PyObject_HEAD
    struct held_words words;
    struct held_words tail_words;
    struct ring_reader ring;
    bool is_disowned;
};

extern PyTypeObject ring_writer_type, ring_reader_type, number_ring_writer_type, number_ring_reader_type;

#endif
