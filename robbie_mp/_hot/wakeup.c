/* Waiting for posts, and posting. */
#define _GNU_SOURCE /* sem_clockwait */
#include "wakeup.h"
#include <errno.h>
#include <fcntl.h>
#include <time.h>

enum { NS_PER_S = 1000000000 };

int wakeup_open(struct wakeup *wakeup, const char *name)
{
    sem_t *semaphore = sem_open(name, 0);
    wakeup->semaphore = semaphore == SEM_FAILED ? NULL : semaphore;
    return semaphore == SEM_FAILED ? errno : 0;
}

void wakeup_close(struct wakeup *wakeup)
{
    sem_t *semaphore = wakeup->semaphore;
    wakeup->semaphore = NULL;
    if (semaphore == NULL)
        return;
    if (wakeup->waiters == 0)
        sem_close(semaphore);
    else
        (void)sem_post(semaphore); /* the threads that wait end their waits, and the last one closes it */
}

void wakeup_post(struct wakeup *wakeup)
{
    /* It fails only if the count is at its limit, and then the process that waits wakes anyway. */
    if (wakeup->semaphore != NULL)
        (void)sem_post(wakeup->semaphore);
}

static bool take_posts(sem_t *semaphore)
{
    int posts = 0;
    if (sem_getvalue(semaphore, &posts) != 0)
        return false;
    if (posts > MAX_POSTS_TAKEN)
        posts = MAX_POSTS_TAKEN;
    for (int taken = 0; taken < posts; taken++) /* never blocks: no other process waits on this semaphore */
        if (sem_trywait(semaphore) != 0)
            return taken > 0;
    return posts > 0;
}

bool wakeup_take(struct wakeup *wakeup)
{
    return take_posts(wakeup->semaphore);
}

void wakeup_begin_wait(struct wakeup *wakeup)
{
    wakeup->waited_on = wakeup->semaphore;
    wakeup->waiters++;
}

void wakeup_end_wait(struct wakeup *wakeup)
{
    if (--wakeup->waiters == 0 && wakeup->semaphore == NULL && wakeup->waited_on != NULL)
        sem_close(wakeup->waited_on);
}

int wakeup_wait(struct wakeup *wakeup, int64_t timeout_ns)
{
    int failed;
    if (wakeup->waited_on == NULL)
        return EINVAL;
    if (timeout_ns < 0) {
        failed = sem_wait(wakeup->waited_on);
    } else {
        const clockid_t clock = WAITS_BY_MONOTONIC_CLOCK ? CLOCK_MONOTONIC : CLOCK_REALTIME;
        struct timespec until;
        clock_gettime(clock, &until);
        int64_t ns = until.tv_nsec + timeout_ns % NS_PER_S;
        until.tv_sec += timeout_ns / NS_PER_S + ns / NS_PER_S;
        until.tv_nsec = ns % NS_PER_S;
#if WAITS_BY_MONOTONIC_CLOCK
        failed = sem_clockwait(wakeup->waited_on, clock, &until);
#else
        failed = sem_timedwait(wakeup->waited_on, &until);
#endif
    }
    if (failed)
        return errno;
    (void)take_posts(wakeup->waited_on);
    return 0;
}
