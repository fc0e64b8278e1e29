/* Words of shared memory: how they are loaded, stored and ordered.
 *
 * Every store to shared memory goes through `store`, so that a test build can count the stores, write them
 * down, and stop before any of them, as if the process had been killed there. */
#ifndef ROBBIE_WORDS_H
#define ROBBIE_WORDS_H

#include <stdatomic.h>
#include <stdint.h>

/* A struct, so that nothing but `store` and `load` compiles: `*place = value` would be a store that no test sees. */
typedef struct {
    _Atomic uint64_t atomic;
} shared_word;

_Static_assert(ATOMIC_LLONG_LOCK_FREE == 2, "a word must be stored in one step");
_Static_assert(sizeof(shared_word) == 8, "words lie beside each other");
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "other processes expect little-endian words");

#ifdef ROBBIE_FUSE
/* Called before every store; does not return if the process is to die here. See tests/bus/hot/_support/fuse.c. */
void before_store(shared_word *place, uint64_t value);
#else
#define before_store(place, value) ((void)0)
#endif

/* Store one word. Stores may be seen in another order, unless a fence lies between them. */
#define store(place, value)                                                                                  \
    do {                                                                                                     \
        shared_word *const store_place = (place);                                                            \
        const uint64_t store_value = (value);                                                                \
        before_store(store_place, store_value);                                                              \
        atomic_store_explicit(&store_place->atomic, store_value, memory_order_relaxed);                       \
    } while (0)

/* Load one word. */
static inline uint64_t load(const shared_word *place)
{
    return atomic_load_explicit(&((shared_word *)place)->atomic, memory_order_relaxed);
}

/* Order all loads and stores before the call before all those after it, as other processes see them. */
static inline void fence(void)
{
    atomic_thread_fence(memory_order_seq_cst);
}

/* Order stores before the call before stores after it; a reader must order its loads likewise. */
static inline void fence_stores(void)
{
    atomic_thread_fence(memory_order_release);
}

/* Order loads before the call before loads and stores after it. */
static inline void fence_loads(void)
{
    atomic_thread_fence(memory_order_acquire);
}

#endif
