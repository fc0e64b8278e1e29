/* A named semaphore by which one process wakes another; see robbie_mp/transport/wakeup.py. */
#ifndef ROBBIE_WAKEUP_H
#define ROBBIE_WAKEUP_H

#include <semaphore.h>
#include <stdbool.h>
#include <stdint.h>

struct wakeup {
    sem_t *semaphore; /* NULL: closed, or it belongs to the process that forked this one */
    sem_t *waited_on; /* the same, for threads that wait; it stays open until the last of them ends its wait */
    int waiters;
};

/* Most posts that one wait takes. Any process of the run can write any count into the semaphore. */
enum { MAX_POSTS_TAKEN = 1000 };

/* Whether time-outs follow CLOCK_MONOTONIC. If not (musl, and glibc before 2.30), they follow the wall clock. */
#if defined(__GLIBC__) && (__GLIBC__ > 2 || (__GLIBC__ == 2 && __GLIBC_MINOR__ >= 30))
#define WAITS_BY_MONOTONIC_CLOCK 1
#else
#define WAITS_BY_MONOTONIC_CLOCK 0
#endif

enum { WAIT_WITHOUT_LIMIT = -1 };

/* Open an existing semaphore; 0, or the error's number. */
int wakeup_open(struct wakeup *wakeup, const char *name);
void wakeup_close(struct wakeup *wakeup);
/* Wake the process that waits; nothing happens if the semaphore is closed. */
void wakeup_post(struct wakeup *wakeup);
/* Take all posts, or MAX_POSTS_TAKEN, without waiting; false if there is none. */
bool wakeup_take(struct wakeup *wakeup);
/* With the GIL, before a wait and after it: no other thread can then close the semaphore that is waited on. */
void wakeup_begin_wait(struct wakeup *wakeup);
void wakeup_end_wait(struct wakeup *wakeup);
/* Wait for a post and take all posts; 0, or the error's number: ETIMEDOUT, EINTR after a signal, others.
 * This may run without the GIL. */
int wakeup_wait(struct wakeup *wakeup, int64_t timeout_ns);

#endif
