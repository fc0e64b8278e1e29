/* A word of shared memory by which one process wakes another; see robbie_mp/bus/transport/wakeup.py. */
#ifndef ROBBIE_WAKEUP_H
#define ROBBIE_WAKEUP_H

#include "words.h"
#include <stdbool.h>
#include <stdint.h>

struct wakeup {
    shared_word *posts;     /* every change of it is a post; NULL: closed, or the forking process owns it */
    shared_word *waited_on; /* the same, for threads that wait; it stays mapped until the last of them returns */
    shared_word *asleep;    /* says whether its process sleeps, which alone writes it; NULL: nothing says so */
    uint32_t seen;          /* the lower half of `posts` when posts were taken last */
    int waiters;
};

enum { WAIT_WITHOUT_LIMIT = -1 };

/* Wake the process that waits; nothing happens if it is closed. */
void wakeup_post(struct wakeup *wakeup);
/* Take all posts without waiting; false if there is none. */
bool wakeup_take(struct wakeup *wakeup);
/* With the GIL, before a wait and after it: no other thread can then unmap what is waited on. */
void wakeup_begin_wait(struct wakeup *wakeup);
void wakeup_end_wait(struct wakeup *wakeup);
/* Wait for a post and take all posts; 0, or the error's number: ETIMEDOUT, EINTR after a signal, others.
 * This may run without the GIL. */
int wakeup_wait(struct wakeup *wakeup, int64_t timeout_ns);
/* Sleep whatever is posted, so that nobody has to wake this process; 0, or EINTR after a signal. */
int wakeup_nap(int64_t nap_ns);

#endif
