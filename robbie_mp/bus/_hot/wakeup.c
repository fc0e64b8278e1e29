/* Waiting for posts, and posting.
 *
 * A module may write anything into the words. So nothing is concluded from a value, except whether it has
 * changed and whether somebody may sleep; the kernel keeps the list of those who do. */
#define _GNU_SOURCE /* syscall */
#include "wakeup.h"
#include <errno.h>
#include <limits.h>
#include <linux/futex.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { NS_PER_S = 1000000000 };

/* The kernel compares 32 bits: the lower half of the word, which comes first (see words.h). */
static uint32_t posts_of(const shared_word *word)
{
    return (uint32_t)load(word);
}

static void wake_sleepers(shared_word *word)
{
    (void)syscall(SYS_futex, word, FUTEX_WAKE, INT_MAX, NULL, NULL, 0);
}

void wakeup_post(struct wakeup *wakeup)
{
    if (wakeup->posts == NULL)
        return;
    atomic_fetch_add_explicit(&wakeup->posts->atomic, 1, memory_order_acq_rel);
    fence(); /* the process that waits sets its word, and then looks at the posts once more */
    if (wakeup->asleep == NULL || load(wakeup->asleep) != 0)
        wake_sleepers(wakeup->posts);
}

static bool take_posts(struct wakeup *wakeup, const shared_word *posts)
{
    const uint32_t found = posts_of(posts);
    if (found == wakeup->seen)
        return false;
    wakeup->seen = found;
    fence_loads();
    return true;
}

bool wakeup_take(struct wakeup *wakeup)
{
    return take_posts(wakeup, wakeup->posts);
}

void wakeup_begin_wait(struct wakeup *wakeup)
{
    if (wakeup->asleep != NULL)
        store(wakeup->asleep, 1);
    fence();
    wakeup->waited_on = wakeup->posts;
    wakeup->waiters++;
}

void wakeup_end_wait(struct wakeup *wakeup)
{
    if (--wakeup->waiters == 0 && wakeup->asleep != NULL)
        store(wakeup->asleep, 0);
}

/* Sleep while the posts are those seen, until somebody wakes this thread; 0, or the error's number. */
static int sleep_while_seen(const struct wakeup *wakeup, const struct timespec *until)
{
    if (syscall(SYS_futex, wakeup->waited_on, FUTEX_WAIT_BITSET, wakeup->seen, until, NULL,
                FUTEX_BITSET_MATCH_ANY) == 0)
        return 0;
    if (errno == EFAULT) /* the file was truncated just now */
        return ETIMEDOUT;
    return errno == EAGAIN ? 0 : errno; /* EAGAIN: they differ */
}

int wakeup_nap(int64_t nap_ns)
{
    const struct timespec nap = {nap_ns / NS_PER_S, nap_ns % NS_PER_S};
    return clock_nanosleep(CLOCK_MONOTONIC, 0, &nap, NULL);
}

int wakeup_wait(struct wakeup *wakeup, int64_t timeout_ns)
{
    struct timespec until; /* by CLOCK_MONOTONIC, as futex(2) has it */
    clock_gettime(CLOCK_MONOTONIC, &until);
    const int64_t ns = until.tv_nsec + timeout_ns % NS_PER_S;
    until.tv_sec += timeout_ns / NS_PER_S + ns / NS_PER_S;
    until.tv_nsec = ns % NS_PER_S;
    if (take_posts(wakeup, wakeup->waited_on))
        return 0;
    const int error = sleep_while_seen(wakeup, timeout_ns < 0 ? NULL : &until);
    if (error == 0 && !take_posts(wakeup, wakeup->waited_on))
        fence_loads(); /* woken, though another process has written back the number that was seen */
    return error;
}
