/* How the hot path adds to a History. */
#ifndef ROBBIE_HISTORY_H
#define ROBBIE_HISTORY_H

#include "native.h"
#include "layout.h"
#include <stdbool.h>

enum { HISTORY_VALUES = 4, MIN_RING_WORDS = 1024 };

/* One event; the meaning of the values is that of its kind in history.py. */
struct history_event {
    uint64_t kind, time_ns, values[HISTORY_VALUES];
};

/* Append an event with its data, or without them if they are too large. It never fails or None: do nothing. The
 * caller has the GIL, so there is one writer at a time. */
void history_append(struct history_object *self, const struct history_event *event, const void *data, uint64_t size);

/* Take memory for what comes next, while there is nothing to do. */
void history_prepare(struct history_object *self);

#endif
