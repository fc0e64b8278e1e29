/* A publisher's blocks as Python objects, for the binding that publishes. */
#ifndef ROBBIE_BLOCK_BINDINGS_H
#define ROBBIE_BLOCK_BINDINGS_H

#include "native.h"

struct block_object {
    PyObject_HEAD
    unsigned long long number;
    unsigned long long segment;
    unsigned long long offset;
    unsigned long long capacity;
    PyObject *memory;         /* the whole segment, as Python uses it */
    struct held_words words;  /* the same memory, held */
};

struct kept_blocks_object {
    PyObject_HEAD
    PyObject *taken; /* dict: blocks in use, by their numbers */
    PyObject *kept;  /* dict: lists of free blocks, by their capacity */
    unsigned long long numbers;
    unsigned long long taken_bytes;
    unsigned long long room_bytes;
};

extern PyTypeObject block_type, kept_blocks_type;

/* The list of free blocks for a message of this size, borrowed; NULL if there is none in it, or with an exception. */
PyObject *kept_for(struct kept_blocks_object *self, uint64_t size);
/* Take the last block of such a list into use; 0, or -1 with an exception. The free bytes are still to be told. */
int take_block(struct kept_blocks_object *self, PyObject *list);
/* Store how many bytes the publisher has free where the subscribers of this block see it. */
void tell_free_bytes(const struct kept_blocks_object *self, const struct block_object *block);
/* Free a block; a number that is not in use is ignored. 0, or -1 with an exception. */
int free_block(struct kept_blocks_object *self, uint64_t number);

#endif
