/* Words of shared memory for ThreadSanitizer, in place of words.h (the same names, and the same include guard).
 *
 * ThreadSanitizer knows no fences. tsan_words.c shows them to it with two fibers for each thread, by the
 * definition of fences in C11 (7.17.4): a release fence orders what the thread did before it before all its
 * later stores; an acquire fence orders what was stored before any word the thread loaded earlier before what
 * it does next. Loads and stores alone order nothing. */
#ifndef ROBBIE_WORDS_H
#define ROBBIE_WORDS_H

#include <stdint.h>

typedef struct {
    uint64_t word;
} shared_word;

/* Each thread calls this before all else. */
void begin_fences(void);
void end_fences(void);

void store(shared_word *place, uint64_t value);
uint64_t load(const shared_word *place);
void fence(void);
void fence_stores(void);
void fence_loads(void);

#endif
