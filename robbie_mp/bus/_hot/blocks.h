/* A publisher's blocks as Python objects, for the binding that publishes. */
#ifndef ROBBIE_BLOCKS_H
#define ROBBIE_BLOCKS_H

#include "native.h"

/* The list of free blocks for a message of this size, borrowed; NULL if there is none in it, or with an exception. */
PyObject *kept_for(struct kept_blocks_object *self, uint64_t size);
/* Take the last block of such a list into use; 0, or -1 with an exception. The free bytes are still to be told. */
int take_block(struct kept_blocks_object *self, PyObject *list);
/* Store how many bytes the publisher has free where the subscribers of this block see it. */
void tell_free_bytes(const struct kept_blocks_object *self, const struct block_object *block);
/* Put a free block into its list, without counting it; 0, or -1 with an exception. */
int keep_block(struct kept_blocks_object *self, struct block_object *block);
/* Free a block; a number that is not in use is ignored. 0, or -1 with an exception. */
int free_block(struct kept_blocks_object *self, uint64_t number);

#endif
