/* Words of shared memory whose stores other threads see late, in place of words.h (the same names, and the same
 * include guard): each thread's stores wait in a buffer, as in processors (total store order, as of x86). A
 * fence waits until its thread's buffer is empty. release_race.c tries every order. */
#ifndef ROBBIE_WORDS_H
#define ROBBIE_WORDS_H

#include <stdint.h>

typedef struct {
    uint64_t word;
} shared_word;

void store(shared_word *place, uint64_t value);
uint64_t load(const shared_word *place);
void fence(void);

/* Stores are seen in their order, and loads are made in theirs. */
static inline void fence_stores(void)
{
}

static inline void fence_loads(void)
{
}

#endif
