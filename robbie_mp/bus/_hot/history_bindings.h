/* The Python type History, and how the hot path adds to it. */
#ifndef ROBBIE_HISTORY_BINDINGS_H
#define ROBBIE_HISTORY_BINDINGS_H

#include "native.h"
#include "layout.h"
#include <stdbool.h>

enum { HISTORY_VALUES = 4 };

struct history_object {
    PyObject_HEAD
    struct held_words words;
    uint64_t capacity, most_capacity; /* bytes of the ring: now, and when it has grown */
    uint64_t key_at; /* where the newest large message is */
    bool has_key, is_disowned;
};

/* One event; the meaning of the values is that of its kind in history.py. */
struct history_event {
    uint64_t kind, time_ns, values[HISTORY_VALUES];
};

extern PyTypeObject history_type;

/* Append an event with its data, or without them if they are too large. It never fails; NULL: do nothing. The
 * caller has the GIL, so there is one writer at a time. */
void history_append(struct history_object *self, const struct history_event *event, const void *data, uint64_t size);

/* Take memory for what comes next, while there is nothing to do. */
void history_prepare(struct history_object *self);

#endif
