/* For tests: counts the stores, writes them down, and leaves by longjmp before one of them. */
#ifndef ROBBIE_FUSE_H
#define ROBBIE_FUSE_H

#ifdef ROBBIE_FUSE
#include "words.h"
#include <setjmp.h>
#include <stddef.h>

struct traced_store {
    shared_word *place;
    uint64_t value;
};

struct fuse {
    uint64_t stores;     /* since it was set */
    uint64_t burns_at;   /* the store before which it burns; UINT64_MAX: never */
    jmp_buf *exit;       /* set by the outermost C function that stores; NULL: it must not burn now */
    struct traced_store *trace;
    size_t traced;
    size_t capacity;
};

extern struct fuse fuse; /* the one global of the test build: a store knows no other way to it */
#endif
#endif
