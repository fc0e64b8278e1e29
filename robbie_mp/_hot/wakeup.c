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
    if (wakeup->semaphore != NULL)
        sem_close(wakeup->semaphore);
    wakeup->semaphore = NULL;
}

void wakeup_post(struct wakeup *wakeup)
{
    /* It fails only if the count is at its limit, and then whoever waits will wake anyway. */
    if (wakeup->semaphore != NULL)
        (void)sem_post(wakeup->semaphore);
}

bool wakeup_take(struct wakeup *wakeup)
{
    int posts = 0;
    if (sem_getvalue(wakeup->semaphore, &posts) != 0)
        return false;
    for (int taken = 0; taken < posts; taken++) /* never blocks: no other process waits on this semaphore */
        if (sem_trywait(wakeup->semaphore) != 0)
            return taken > 0;
    return posts > 0;
}

int wakeup_wait(struct wakeup *wakeup, int64_t timeout_ns)
{
    int failed;
    if (timeout_ns < 0) {
        failed = sem_wait(wakeup->semaphore);
    } else {
        const clockid_t clock = WAITS_BY_MONOTONIC_CLOCK ? CLOCK_MONOTONIC : CLOCK_REALTIME;
        struct timespec until;
        clock_gettime(clock, &until);
        int64_t ns = until.tv_nsec + timeout_ns % NS_PER_S;
        until.tv_sec += timeout_ns / NS_PER_S + ns / NS_PER_S;
        until.tv_nsec = ns % NS_PER_S;
#if WAITS_BY_MONOTONIC_CLOCK
        failed = sem_clockwait(wakeup->semaphore, clock, &until);
#else
        failed = sem_timedwait(wakeup->semaphore, &until);
#endif
    }
    if (failed)
        return errno;
    (void)wakeup_take(wakeup);
    return 0;
}
