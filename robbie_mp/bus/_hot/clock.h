/* The machine's monotonic clock, which stamps messages. */
#ifndef ROBBIE_CLOCK_H
#define ROBBIE_CLOCK_H

#include <stdint.h>

/* Nanoseconds of the clock, as Python's time.monotonic_ns. */
uint64_t monotonic_ns(void);

#endif
