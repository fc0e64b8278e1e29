/* A reentrant lock that C code can look at. */
#ifndef ROBBIE_LOCK_H
#define ROBBIE_LOCK_H

#include "native.h"
#include <pythread.h>

/* Whether another thread holds it. If not, and until you let go of the GIL, you need not take it. */
bool lock_is_elsewhere(const struct lock_object *lock);
/* Take it, waiting without the GIL if need be; 0, or -1 with the exception of a signal's handler set. */
int lock_take(struct lock_object *lock);
void lock_give(struct lock_object *lock);

#endif
