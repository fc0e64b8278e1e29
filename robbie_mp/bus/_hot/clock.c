/* Reading the machine's monotonic clock. */
#define _POSIX_C_SOURCE 200809L
#include "clock.h"
#include <time.h>

#ifndef ROBBIE_FUSE /* in the test build the tests turn the clock */
uint64_t monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000 + (uint64_t)now.tv_nsec;
}
#endif
